"""A public planar Cosserat rod, usable without the robot: statics, vibration and motion."""
