"""A leg as a planar rod: bending in the leg's plane and stretch; fast, and wrong sideways."""
