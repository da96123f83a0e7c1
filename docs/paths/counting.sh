# A video of a reef: from an empty folder to counts with intervals and a page. Set HUB and KEY first: they are on the page of a hub.
pip install "oysterbench[learn]"
oysterbench download unet --from "$HUB" --key "$KEY"
oysterbench segment dive.mp4 --out counted
