"""Environment in which policies of a stride are learned, and a learner."""
