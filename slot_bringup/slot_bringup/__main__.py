"""Entry point of scripts/run: an interrupt while the modules load ends in one line, too."""

import signal
import sys

try:
    from slot_bringup.run import main

    code = main()
except KeyboardInterrupt:
    print("scripts/run: interrupted", file=sys.stderr)
    code = 130
for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
    signal.signal(number, signal.SIG_IGN)  # Python would die of it while it takes its leave
sys.exit(code)
