"""A method, a data set and a metric for dynaviz: copy this folder, rename it, and change one thing at a time."""
