"""Methods written plainly, point by point, to compare the fast ones with."""
