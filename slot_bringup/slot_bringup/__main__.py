"""Entry point of scripts/run: an interrupt while the modules load ends in one line, too."""

import sys

try:
    from slot_bringup.run import main

    sys.exit(main())
except KeyboardInterrupt:
    print("scripts/run: interrupted", file=sys.stderr)
    sys.exit(130)
