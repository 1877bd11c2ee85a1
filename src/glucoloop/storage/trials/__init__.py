"""The folder of a trial: shards that appear whole, what became of them, and questions to them."""
