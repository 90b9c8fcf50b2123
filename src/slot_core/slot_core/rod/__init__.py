"""A public spatial Cosserat rod, usable without the robot: statics, vibration and motion."""
