"""Reports on many results: the numbers (boards), the tables, the figures, and four formats."""
