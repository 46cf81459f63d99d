"""Error against run time: scenes x methods, measured together, as tables, figures and a page in words."""
