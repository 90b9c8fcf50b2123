"""A leg as a spatial rod: bending in both planes, twist and stretch."""
