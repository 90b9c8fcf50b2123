"""Description of the node graph, and the programs that start, watch and operate it."""

from slot_core.command_line import require_libraries

require_libraries()
