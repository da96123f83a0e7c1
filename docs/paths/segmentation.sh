# Your own network: from an empty folder to its IoU on a reef it has not seen, beside that of a colour rule.
pip install "oysterbench[render,learn]"
python my_net.py
oysterbench run my_net:MyNet colour --split seg-mini --sequence mini-02 --out mine
oysterbench compare mine --report comparison.html
