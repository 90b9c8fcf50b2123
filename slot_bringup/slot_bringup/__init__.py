"""Description of the node graph, and the programs that start, watch and operate it."""

import signal

from slot_core.libraries import require_libraries

require_libraries()

INTERRUPTS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)  # SIGHUP: the terminal is closed
