"""The one description of the graph, and what starts it."""
