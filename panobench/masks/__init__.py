"""Masks: which part of the view does not belong to the scene, found before a method starts."""
