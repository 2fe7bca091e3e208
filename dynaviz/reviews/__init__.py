"""Decisions of a person about parts of a world, and the places worth a decision.

Private: other packages do not import it.
"""
