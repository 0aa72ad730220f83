"""`import palpate` loads none of the heavy libraries."""

import subprocess
import sys

HEAVY = "{'sklearn', 'cv2', 'matplotlib', 'PIL', 'rich'}"


def test_import_loads_nothing_heavy():
    code = f"import palpate, sys; print(sorted({HEAVY} & set(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"
