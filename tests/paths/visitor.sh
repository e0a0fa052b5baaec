# A visitor: one command, a page with pictures.
rogs demo --episodes 1
test -s rogs-demo/run/report/index.html
