"""The public Cosserat rod: statics, vibration and motion, for use without the robot."""
