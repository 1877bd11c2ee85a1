from .columns import comparison_table as comparison_table
from .columns import metrics_table as metrics_table
from .figure import plot as plot
from .identification_figure import plot_identification as plot_identification
from .identification_figure import plot_validation as plot_validation
from .page import interactive_page as interactive_page
from .template import Repeat as Repeat
