"""Folder of a trial: shards that appear complete, their results, and queries to them."""
