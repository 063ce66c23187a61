"""The arena: a benchmark that anybody can enter. Entries explore or map fixed plans, and are ranked."""
