# x
Vertex 1 0 0 0
Vertex 2 1 0 0
Vertex 5 0 1 0.5 {n=1}
Face 1 1 2 5
