"""Signal handling of the test process."""

import signal

# A process started in the background of a script ignores SIGINT, and so do its children; those that
# the tests interrupt must receive it.
signal.signal(signal.SIGINT, signal.default_int_handler)
