"""Makes one page in Markdown of the paper's figures and claims, beside what was measured here.

Ours are read from the results of scripts/bench and scripts/validate. The page names the revision and
machine of each, and the command of each that is missing. All figures of the benchmarks are made into
a page by scripts/docs --figures.
"""

import sys
from collections.abc import Sequence
from pathlib import Path

from slot_core.command_line import CommandParser, refuse

CANNOT_REPORT = 2  # exit code


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line of `scripts/report`; ends with exit code 2 and one line on a bad input."""
    parser = CommandParser(prog="scripts/report", description=__doc__)
    for name, kind, default in (
        ("--results", "DIR", "results"),
        ("--out", "FILE", "results/report.md"),
    ):
        parser.add_argument(
            name,
            type=Path,
            metavar=kind,
            default=default,
            help=f"default: {default}",
        )
    options = parser.parse_args(arguments)
    from documentation.paper_page import render  # noqa: PLC0415 - heavy
    from documentation.results import ReportError  # noqa: PLC0415 - heavy

    try:
        if options.out.suffix != ".md":
            raise ReportError(
                f"--out {options.out}: expected a name that ends in .md"
            )
        page = render(options.results)
        options.out.parent.mkdir(parents=True, exist_ok=True)
        options.out.write_text(page, encoding="utf-8", errors="replace")
    except (ReportError, OSError) as error:
        refuse(parser.prog, error)
        return CANNOT_REPORT
    print(options.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
