"""Error against run time: scenes by methods, measured together, with a page in words."""
