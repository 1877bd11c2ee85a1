"""Files: models, tables, reports and their folders, written completely or not at all."""
