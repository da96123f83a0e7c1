# A video of a reef: from an empty folder to counts with intervals and a page.
pip install "oysterbench[learn]"
HUB=https://hub.example KEY=PUBLIC_KEY    # both are on the page of your hub
oysterbench download unet --from "$HUB" --key "$KEY"
oysterbench segment dive.mp4 --out counted
