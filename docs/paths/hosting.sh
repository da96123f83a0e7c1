# Your own board: from an empty folder to a submission that it has scored and published.
pip install "oysterbench[board,render]"
oysterbench run dead_reckoning --split slam-mini --out runs
oysterbench leaderboard team add "reef lab" --submissions private --token-file token
mkdir board && oysterbench leaderboard serve --board board --submissions private &
oysterbench submit runs --to http://127.0.0.1:8000 --method dead_reckoning --team-token-file token --publish
oysterbench leaderboard --board board
