"""Command line of `scripts/bench`."""

import argparse
import json
import signal
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.harness import ROOT, BenchmarkError, about, add_options, known, run
from slot_core.command_line import INTERRUPTED, CommandParser, progress, refuse

CANNOT_RUN = 2  # exit code


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line of `scripts/bench`; returns the exit code."""
    parser = _parser()
    common, _ = _parser(add_help=False).parse_known_args(arguments)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        own = _add_options(parser, common)
        options = parser.parse_args(arguments)
        there = known(options.benchmarks)
        if options.list:
            for name, path in there.items():
                print(f"{name:<16}{about(path)}")
            return 0
        if options.name is None:
            parser.error(f"no benchmark named (known: {', '.join(there) or 'none'})")
        out = options.out or Path("results") / options.name
        chosen = {name: getattr(options, name) for name in own}
        path = run(
            options.name, options.benchmarks, options.quick, out, progress, **chosen
        )
    except BenchmarkError as error:
        refuse("scripts/bench", error)
        return CANNOT_RUN
    except KeyboardInterrupt:
        print("scripts/bench: interrupted", file=sys.stderr)
        return INTERRUPTED
    for line in check_lines(json.loads(path.read_text())["checks"]):
        print(line)
    print(path)
    return 0


def check_lines(checks: Sequence[Mapping[str, Any]]) -> list[str]:
    """Aligned lines `holds  name  value unit  (goal)`."""
    width = max((len(check["name"]) for check in checks), default=0)
    return [
        f"{'holds' if c['holds'] else 'MISSED':<7} {c['name']:<{width}}  "
        f"{'-' if c['value'] is None else format(c['value'], '.4g')} {c['unit']} (goal {c['goal']})"
        for c in checks
    ]


def _add_options(
    parser: argparse.ArgumentParser, common: argparse.Namespace
) -> list[str]:
    """Add the options of the named benchmark, if any; returns their names."""
    if common.name is None or common.list:
        return []
    add_options(parser, common.name, common.benchmarks)
    return sorted(vars(parser.parse_args([common.name])).keys() - vars(common).keys())


def _parser(add_help: bool = True) -> argparse.ArgumentParser:
    parser = CommandParser(
        prog="scripts/bench",
        description="Runs a benchmark and writes DIR/NAME.json.",
        epilog="NAME --help also names the options of that benchmark.",
        add_help=add_help,
    )
    parser.add_argument("name", nargs="?", metavar="NAME", help="benchmark, see --list")
    parser.add_argument(
        "--quick", action="store_true", help="fewer repeats, rougher figures"
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="default: results/NAME")
    parser.add_argument("--list", action="store_true", help="list the benchmarks")
    parser.add_argument(
        "--benchmarks",
        type=Path,
        metavar="DIR",
        default=ROOT / "scripts" / "benchmarks",
        help="where the benchmarks are (default: scripts/benchmarks)",
    )
    return parser


if __name__ == "__main__":
    sys.exit(main())
