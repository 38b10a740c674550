"""Statistics: errors of the fitted numbers, and which of them the views determine."""
