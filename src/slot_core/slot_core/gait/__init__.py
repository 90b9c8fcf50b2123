"""Gaits: strides, schedule, routes, reference, and the feedback once a stride."""
