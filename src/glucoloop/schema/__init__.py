"""Files that glucoloop writes and reads back: what they hold is declared once, and one check reads them."""
