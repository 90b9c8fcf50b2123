"""The site of the documentation (`conf.py`), its tables of the graph and its pictures."""

import os
from pathlib import Path

ROOT = Path(os.environ.get("SLOT_ROOT") or Path(__file__).resolve().parents[2])
DOC = ROOT / "slot_bringup" / "doc"
