# A SLAM program in C++: from an empty folder to its errors beside those of a baseline.
pip install "oysterbench[render]"
c++ -O2 -o my_slam my_slam.cpp
oysterbench run my_slam --command "./my_slam {euroc} {out}" --split slam-mini --out mine
oysterbench compare mine gtsam_vi --split slam-mini --report comparison.html
