"""Markers seen by a camera: camera model, boards, localisation, tracking, a synthetic camera."""
