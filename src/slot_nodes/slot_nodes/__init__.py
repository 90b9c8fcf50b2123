"""ROS nodes, one per box of the graph: decode messages, call the core, encode its results."""
