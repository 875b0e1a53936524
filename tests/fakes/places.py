"""Where the tests find their files."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SAMPLES = ROOT / "data_samples"
PUBLISHED = SAMPLES / "published"
# Real public logs, which are not part of the repository; tests that read them skip where they are absent.
DATA = ROOT.parent / "shared" / "data"
REAL = ROOT.parent / "shared" / "real"
