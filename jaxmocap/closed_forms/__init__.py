"""The documents' hand-derived derivatives and procedures, kept beside the autodiff ones to be compared with them.

Imported by workflows, notebooks, scripts and tests only. `PAIRS` is the one table of comparisons.
"""

from jaxmocap.closed_forms.pairs import PAIRS as PAIRS
from jaxmocap.closed_forms.pairs import Pair as Pair
