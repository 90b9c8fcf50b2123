"""Entry point of scripts/run; an interrupt during the imports also ends with a one-line message."""

import signal
import sys

from slot_bringup.arguments import parse
from slot_bringup.interrupts import INTERRUPTS

try:
    options = parse()  # before what only a run imports
    from slot_bringup.run import run_and_report

    code = run_and_report(options)
except KeyboardInterrupt:
    print("scripts/run: interrupted", file=sys.stderr)
    code = 130
for number in INTERRUPTS:
    # else one during finalisation would kill the interpreter
    signal.signal(number, signal.SIG_IGN)
sys.exit(code)
