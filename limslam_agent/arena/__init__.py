"""The arena: a benchmark that anybody can enter. Entries explore fixed plans, and are ranked."""
