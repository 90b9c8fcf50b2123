"""One thin rclpy node per box of the graph: decode, call the core, encode."""
