"""Command line of `scripts/bench`."""

import json
import signal
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.harness import BenchmarkError, known, run
from slot_core.command_line import INTERRUPTED, CommandParser, progress, refuse

CANNOT_RUN = 2  # exit code


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line of `scripts/bench`; returns the exit code."""
    parser = CommandParser(
        prog="scripts/bench",
        description="Runs a benchmark and writes DIR/NAME.json.",
    )
    add = parser.add_argument
    add("name", nargs="?", metavar="NAME", help="benchmark, see --list")
    add("--quick", action="store_true", help="fewer repeats, rougher figures")
    add("--out", type=Path, metavar="DIR", help="default: results/NAME")
    add("--list", action="store_true", help="list the benchmarks")
    options = parser.parse_args(arguments)
    if options.list:
        for name, subject in known().items():
            print(f"{name:<16}{subject}")
        return 0
    if options.name is None:
        parser.error(f"no benchmark named (known: {', '.join(known())})")
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    out = options.out or Path("results") / options.name
    try:
        path = run(options.name, options.quick, out, progress)
    except BenchmarkError as error:
        refuse(parser.prog, error)
        return CANNOT_RUN
    except KeyboardInterrupt:
        print("scripts/bench: interrupted", file=sys.stderr)
        return INTERRUPTED
    print(*check_lines(json.loads(path.read_text())["checks"]), path, sep="\n")
    return 0


def check_lines(checks: Sequence[Mapping[str, Any]]) -> list[str]:
    """Aligned lines `holds  name  value unit  (goal)`."""
    width = max((len(check["name"]) for check in checks), default=0)
    return [
        f"{'holds' if c['holds'] else 'MISSED':<7} {c['name']:<{width}}  "
        f"{'-' if c['value'] is None else format(c['value'], '.4g')} {c['unit']} (goal {c['goal']})"
        for c in checks
    ]


if __name__ == "__main__":
    sys.exit(main())
