"""The Chromium of this machine."""

import shutil

NAMES = ("chromium", "chromium-browser", "google-chrome")
CHROMIUM = next(filter(None, map(shutil.which, NAMES)), None)
assert CHROMIUM, f"There is none of {', '.join(NAMES)}; install one, on Debian package chromium."
