"""The shipped worlds, as TOML files."""
