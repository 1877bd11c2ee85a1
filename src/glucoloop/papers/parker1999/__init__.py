"""Parker, Doyle and Peppas (1999), carried out again: every table, figure and claim beside the printed one."""
