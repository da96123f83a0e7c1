# A video of a reef: from an empty folder to counts with intervals and a page.
pip install "oysterbench[learn]"
oysterbench segment dive.mp4 --out counted
