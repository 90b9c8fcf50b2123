"""What every test takes for granted of the process it runs in."""

import signal

# Started in the background of a script, a process ignores SIGINT and so do its children; those
# that the tests interrupt must hear it.
signal.signal(signal.SIGINT, signal.default_int_handler)
