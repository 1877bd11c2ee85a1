"""Files: models, tables, reports and the folders they go to, written whole or not at all."""
