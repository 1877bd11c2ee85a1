"""Published studies, each reproduced in full."""
