"""Reproduction of Parker, Doyle and Peppas (1999): every table, figure and claim beside the printed one."""
