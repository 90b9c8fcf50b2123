"""What runs the nodes of a process: executor, intra-process communication, composition."""
