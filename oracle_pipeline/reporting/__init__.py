"""Reports: the thesis's tables beside ours, our evaluation, pictures, one HTML page."""
