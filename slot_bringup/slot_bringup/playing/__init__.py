"""The page in the browser to play with the robot."""
