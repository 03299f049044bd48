"""Frames, boxes and volumes."""
