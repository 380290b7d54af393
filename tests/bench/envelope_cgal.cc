// CGAL's edge collapse, where Debian's libcgal-dev is installed; a bench's peer, needed by nothing else.
#include <stdint.h>

extern "C" {
bool bench_has_cgal(void);
uint32_t bench_cgal_collapse(const float (*positions)[3], uint32_t vertex_count, const uint32_t (*triangles)[3], uint32_t triangle_count,
                             uint32_t target, float (*out_positions)[3], uint32_t *out_vertices, uint32_t (*out_triangles)[3]);
}

#if __has_include(<CGAL/Surface_mesh.h>)
#define CGAL_DISABLE_GMP 1
#include <CGAL/Simple_cartesian.h>
#include <CGAL/Surface_mesh.h>
#include <CGAL/Surface_mesh_simplification/Policies/Edge_collapse/Count_ratio_stop_predicate.h>
#include <CGAL/Surface_mesh_simplification/Policies/Edge_collapse/Count_stop_predicate.h>
#include <CGAL/Surface_mesh_simplification/edge_collapse.h>

#include <vector>

using Kernel = CGAL::Simple_cartesian<double>;
using Surface = CGAL::Surface_mesh<Kernel::Point_3>;

bool bench_has_cgal(void) {
  return true;
}

uint32_t bench_cgal_collapse(const float (*positions)[3], uint32_t vertex_count, const uint32_t (*triangles)[3], uint32_t triangle_count,
                             uint32_t target, float (*out_positions)[3], uint32_t *out_vertices, uint32_t (*out_triangles)[3]) try {
  Surface surface;
  std::vector<Surface::Vertex_index> vertices;
  for (uint32_t v = 0; v < vertex_count; v++)
    vertices.push_back(surface.add_vertex(Kernel::Point_3(positions[v][0], positions[v][1], positions[v][2])));
  for (uint32_t t = 0; t < triangle_count; t++)
    if (surface.add_face(vertices[triangles[t][0]], vertices[triangles[t][1]], vertices[triangles[t][2]]) == Surface::null_face())
      return 0;
  // CGAL counts edges: three a two triangles.
  CGAL::Surface_mesh_simplification::Count_stop_predicate<Surface> stop(target + target / 2);
  CGAL::Surface_mesh_simplification::edge_collapse(surface, stop);
  std::vector<uint32_t> index(surface.num_vertices() + surface.number_of_removed_vertices(), UINT32_MAX);
  uint32_t count = 0, faces = 0;
  for (auto v : surface.vertices()) {
    const auto &p = surface.point(v);
    out_positions[count][0] = (float)p.x();
    out_positions[count][1] = (float)p.y();
    out_positions[count][2] = (float)p.z();
    index[(size_t)v] = count++;
  }
  for (auto f : surface.faces()) {
    int k = 0;
    for (auto v : surface.vertices_around_face(surface.halfedge(f)))
      out_triangles[faces][k++] = index[(size_t)v];
    faces++;
  }
  *out_vertices = count;
  return faces;
} catch (...) {
  return 0;
}

#else

bool bench_has_cgal(void) {
  return false;
}

uint32_t bench_cgal_collapse(const float (*)[3], uint32_t, const uint32_t (*)[3], uint32_t, uint32_t, float (*)[3], uint32_t *,
                             uint32_t (*)[3]) {
  return 0;
}

#endif
