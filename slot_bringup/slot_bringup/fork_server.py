"""Imported by the fork server alone: signals of the terminal do not reach it, it ends with its parent.

A SIGINT ends its forks from the beginning, before they have set a handler.
"""

import os
import signal

from slot_bringup.forked_node import FROM_TERMINAL, end_with_parent

end_with_parent()
os.setsid()
signal.signal(signal.SIGINT, signal.SIG_DFL)
signal.pthread_sigmask(signal.SIG_UNBLOCK, FROM_TERMINAL)
