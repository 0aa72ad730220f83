"""How well it recognises: splits, figures, nuisance controls and reports."""

from ._benchmark import benchmark
from ._comparisons import brightness as brightness
from ._comparisons import control_log_likelihood as control_log_likelihood
from ._comparisons import named_alone as named_alone
from ._comparisons import without_contact as without_contact
from ._evaluate import evaluate
from ._evaluate import few_touches as few_touches
from ._report import explained_episodes as explained_episodes
from ._report import write_report
from ._splits import split_by_count as split_by_count
from ._splits import split_touches
from ._trial import Plan, calibration_error, davies_bouldin, roc_area

__all__ = [
    "Plan",
    "benchmark",
    "calibration_error",
    "davies_bouldin",
    "evaluate",
    "roc_area",
    "split_touches",
    "write_report",
]
