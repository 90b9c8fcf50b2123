"""Markers seen by a camera: camera model, boards, localisation, a synthetic camera."""
