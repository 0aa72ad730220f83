"""Let torchvision be imported beside a torch that was built for processors alone."""

import contextlib

with contextlib.suppress(ImportError):
    import torch

    # The wheel of torchvision needs CUDA for its compiled operators; without them it
    # cannot even be imported unless they are declared. None of them is used here.
    if torch.version.cuda is None:
        for name in ("nms", "qnms"):
            schema = "(Tensor dets, Tensor scores, float iou) -> Tensor"
            torch.library.define(f"torchvision::{name}", schema)
