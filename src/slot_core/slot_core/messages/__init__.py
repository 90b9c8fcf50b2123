"""ROS messages decoded into values of the core, without ROS."""
