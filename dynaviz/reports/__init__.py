"""Reports and boards: many results on one page."""
