"""Statistics, tables, figures and the report of the results of a suite."""
