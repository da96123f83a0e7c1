# A video of a reef: from an empty folder to counts with intervals and a page.
pip install "oysterbench[learn,score]"
oysterbench segment dive.mp4 --out counted
