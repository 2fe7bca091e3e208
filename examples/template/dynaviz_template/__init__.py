"""A method, a data set and a metric for dynaviz.

Copy this folder, rename it, and change one part at a time.
"""
