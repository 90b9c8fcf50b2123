"""ROS nodes, one per box of the graph: decode messages, call the core, encode its results."""

from slot_core.command_line import require_libraries

require_libraries()
