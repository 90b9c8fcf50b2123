"""Colours of all plots: Okabe and Ito's palette for colour-blind readers; each leg has its own."""

from slot_core.robot import LEGS

LEG_COLOURS = dict(zip(LEGS, ("#0072B2", "#E69F00", "#009E73", "#CC79A7")))
INK = "#22282e"
TRUE = "#0072B2"
SECONDARY = "#D55E00"
PALE = "#b8c4ce"
SHADE = "#eef1f4"
TORSO = "#8796a5"
STAGE_COLOURS = ("#56B4E9", "#009E73", "#D55E00", "#CC79A7")
