"""SLOT's algorithms: the soft quadruped's dynamics, control and evaluation, free of ROS."""
