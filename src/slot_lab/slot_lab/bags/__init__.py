"""Bags: reading, checking against the code here, repairing; motion and ticks of a walk."""
