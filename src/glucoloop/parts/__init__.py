"""Parts: everything that a user names, as a name with settings, in one grammar for command line, files and Python."""
