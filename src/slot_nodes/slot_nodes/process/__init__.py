"""Nodes of a process: executor, intra-process communication, composition."""
