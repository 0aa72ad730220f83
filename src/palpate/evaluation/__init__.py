"""How well it recognises: splits, figures, nuisance controls and reports."""

from ._cluster_quality import davies_bouldin
from ._controls import brightness, disc_centres, sorted_pixels, without_contact
from ._decisions import Decisions, decide_episodes
from ._episodes import Episodes, Outcome, outcome, run_episodes, single_touches
from ._evaluate import evaluate
from ._metrics import calibration_bins, calibration_error, roc_area
from ._report import PAGE_STYLE, check_report_path, write_report
from ._splits import SPLITS, Fold, draw_touches, split_by_count, split_touches
from ._trial import Plan, Trial

__all__ = [
    "PAGE_STYLE",
    "SPLITS",
    "Decisions",
    "Episodes",
    "Fold",
    "Outcome",
    "Plan",
    "Trial",
    "brightness",
    "calibration_bins",
    "calibration_error",
    "check_report_path",
    "davies_bouldin",
    "decide_episodes",
    "disc_centres",
    "draw_touches",
    "evaluate",
    "outcome",
    "roc_area",
    "run_episodes",
    "single_touches",
    "sorted_pixels",
    "split_by_count",
    "split_touches",
    "without_contact",
    "write_report",
]
