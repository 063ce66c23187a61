"""Statistics, tables, figures and the report of a suite's results."""
