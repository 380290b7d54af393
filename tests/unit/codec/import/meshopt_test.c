#include <math.h>

#include "codec/import/meshopt.h"
#include "tests/data/shapes.h"
#include "tests/unit/codec/import/importing.h"
#include "tests/unit/codec/import/meshopt_encoding.h"

static enum lod_status decode(enum lod_meshopt_mode mode, enum lod_meshopt_filter filter, uint8_t *out, size_t count, size_t stride,
                              const uint8_t *bytes, size_t size) {
  uint8_t *exact = malloc(size ? size : 1);
  memcpy(exact, bytes, size);
  enum lod_status status = lod_meshopt_decode(mode, filter, out, count, stride, exact, size, NULL);
  free(exact);
  return status;
}

static void attributes_of_every_stride_and_encoding_come_back(void **state) {
  (void)state;
  static const size_t kStrides[] = {4, 12, 16, 64, 256}, kCounts[] = {1, 15, 16, 17, 200, 700};
  uint64_t seed = 1;
  for (size_t s = 0; s < 5; s++)
    for (size_t c = 0; c < 6; c++)
      for (int pick = 1; pick <= 3; pick++) {
        size_t size = kStrides[s] * kCounts[c];
        uint8_t *data = malloc(size), *out = malloc(size);
        for (size_t i = 0; i < size; i++) /* mostly small steps, some wild ones */
          data[i] = (uint8_t)((i >= kStrides[s] ? data[i - kStrides[s]] : 7) +
                              (lod_random_next(&seed) % 8 ? lod_random_next(&seed) % 3 : lod_random_next(&seed)));
        struct test_bytes stream = test_meshopt_attributes(data, kCounts[c], kStrides[s], pick);
        assert_int_equal(decode(LOD_MESHOPT_ATTRIBUTES, LOD_MESHOPT_NONE, out, kCounts[c], kStrides[s], stream.bytes, stream.size), LOD_OK);
        assert_memory_equal(out, data, size);
        free(stream.bytes);
        free(data);
        free(out);
      }
}

/* The worked example of appendix A: ten bytes of 4-bit sentinel coding. */
static void the_specifications_example_decodes_to_its_deltas(void **state) {
  (void)state;
  static const uint8_t example[10] = {0x17, 0x5F, 0xF0, 0xBC, 0x77, 0xA9, 0x21, 0x00, 0x34, 0xB5};
  static const int deltas[16] = {-1, -4, -3, 26, -91, 0, -6, 6, -4, -4, 5, -5, 1, -1, 0, 0};
  struct test_bytes stream = {0};
  uint8_t tail[32] = {0}, out[64], value = 0;
  test_append(&stream, "\xA0\x02", 2);
  test_append(&stream, example, 10);
  test_append(&stream, "\0\0\0", 3); /* the other three bytes of an element do not change */
  test_append(&stream, tail, 32);
  assert_int_equal(decode(LOD_MESHOPT_ATTRIBUTES, LOD_MESHOPT_NONE, out, 16, 4, stream.bytes, stream.size), LOD_OK);
  for (int i = 0; i < 16; i++) {
    value = (uint8_t)(value + deltas[i]);
    assert_int_equal(out[4 * i], value);
    assert_int_equal(out[4 * i + 1], 0);
  }
  free(stream.bytes);
}

/* next next next, then an edge with a new vertex, an old one, explicit ones. */
static const uint8_t kTriangles[] = {0xE1, 0xF0, 0x10, 0x02, 0x0F, 0xFF, 0x0E, 0x14, 0xFF, 0x0A, 0x02, 0x02, 0, 0,
                                     0,    0,    0,    0,    0,    0,    0,    0,    0,    0,    0,    0,    0, 0};

static void triangle_codes_follow_the_fifos(void **state) {
  (void)state;
  uint32_t t[6][3];
  assert_int_equal(decode(LOD_MESHOPT_TRIANGLES, LOD_MESHOPT_NONE, (uint8_t *)t, 18, 4, kTriangles, sizeof kTriangles), LOD_OK);
  /* F0 with table 00: 0 1 2. Edges pushed: (1,0) (2,1) (0,2). */
  assert_true(t[0][0] == 0 && t[0][1] == 1 && t[0][2] == 2);
  /* 10: the edge before the last, (2,1), and next = 3. Pushed: (3,1) (2,3). */
  assert_true(t[1][0] == 2 && t[1][1] == 1 && t[1][2] == 3);
  /* 02: the last edge (2,3) with vertex FIFO[2] of 3 2 1 0 = 1. */
  assert_true(t[2][0] == 2 && t[2][1] == 3 && t[2][2] == 1);
  /* 0F: the last edge (2,1) with last + zigzag(0x14) = 10. */
  assert_true(t[3][0] == 2 && t[3][1] == 1 && t[3][2] == 10);
  /* FF FF: three explicit ones: 10 + 5, + 1, + 1. */
  assert_true(t[4][0] == 15 && t[4][1] == 16 && t[4][2] == 17);
  /* 0E: the last edge (15,17) with last + 1. */
  assert_true(t[5][0] == 15 && t[5][1] == 17 && t[5][2] == 18);
}

static void indices_follow_two_baselines(void **state) {
  (void)state;
  /* 5 on baseline 0, 100 on baseline 1, 6 on 0, 99 on 1 */
  const uint8_t stream[] = {0xD1, 20, 0x91, 0x03, 4, 3, 0, 0, 0, 0};
  uint16_t out[4];
  assert_int_equal(decode(LOD_MESHOPT_INDICES, LOD_MESHOPT_NONE, (uint8_t *)out, 4, 2, stream, sizeof stream), LOD_OK);
  assert_true(out[0] == 5 && out[1] == 100 && out[2] == 6 && out[3] == 99);
}

static void every_prefix_of_a_stream_is_refused(void **state) {
  (void)state;
  uint8_t data[200 * 12], out[200 * 12];
  uint64_t seed = 9;
  for (size_t i = 0; i < sizeof data; i++)
    data[i] = (uint8_t)lod_random_next(&seed);
  struct test_bytes stream = test_meshopt_attributes(data, 200, 12, 2);
  for (size_t n = 0; n < stream.size; n++)
    assert_int_equal(decode(LOD_MESHOPT_ATTRIBUTES, LOD_MESHOPT_NONE, out, 200, 12, stream.bytes, n), LOD_BAD_INPUT);
  free(stream.bytes);
  for (size_t n = 0; n < sizeof kTriangles; n++)
    assert_int_equal(decode(LOD_MESHOPT_TRIANGLES, LOD_MESHOPT_NONE, out, 18, 4, kTriangles, n), LOD_BAD_INPUT);
}

static void wrong_arguments_are_refused(void **state) {
  (void)state;
  uint8_t out[64], stream[64] = {0xA0};
  assert_int_equal(lod_meshopt_decode(LOD_MESHOPT_ATTRIBUTES, LOD_MESHOPT_NONE, out, 1, 6, stream, 64, NULL), LOD_BAD_INPUT);
  assert_int_equal(lod_meshopt_decode(LOD_MESHOPT_ATTRIBUTES, LOD_MESHOPT_OCTAHEDRAL, out, 1, 12, stream, 64, NULL), LOD_BAD_INPUT);
  assert_int_equal(lod_meshopt_decode(LOD_MESHOPT_TRIANGLES, LOD_MESHOPT_NONE, out, 4, 4, stream, 64, NULL), LOD_BAD_INPUT);
  assert_int_equal(lod_meshopt_decode(LOD_MESHOPT_INDICES, LOD_MESHOPT_NONE, out, 4, 3, stream, 64, NULL), LOD_BAD_INPUT);
  assert_int_equal(lod_meshopt_decode(LOD_MESHOPT_INDICES, LOD_MESHOPT_EXPONENTIAL, out, 4, 4, stream, 64, NULL), LOD_BAD_INPUT);
}

/* One element through a filter. */
static void filtered(enum lod_meshopt_filter filter, const void *element, size_t stride, void *out) {
  struct test_bytes stream = test_meshopt_attributes(element, 1, stride, 3);
  assert_int_equal(decode(LOD_MESHOPT_ATTRIBUTES, filter, out, 1, stride, stream.bytes, stream.size), LOD_OK);
  free(stream.bytes);
}

static void octahedral_normals_have_unit_length_on_both_hemispheres(void **state) {
  (void)state;
  for (int x = -511; x <= 511; x += 73)
    for (int y = -511; y <= 511; y += 73) {
      const int16_t in[4] = {(int16_t)x, (int16_t)y, 511, 7};
      int16_t out[4];
      filtered(LOD_MESHOPT_OCTAHEDRAL, in, 8, out);
      double v[3] = {out[0] / 32767.0, out[1] / 32767.0, out[2] / 32767.0};
      assert_true(fabs(sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]) - 1) < 1e-4);
      assert_true((abs(x) + abs(y) < 511) == (out[2] > 0) || abs(x) + abs(y) == 511);
      assert_int_equal(out[3], 7);
    }
  const int8_t up[4] = {0, 0, 127, 3};
  int8_t out[4];
  filtered(LOD_MESHOPT_OCTAHEDRAL, up, 4, out);
  assert_true(out[0] == 0 && out[1] == 0 && out[2] == 127 && out[3] == 3);
}

static void a_quaternion_gets_its_largest_component_back(void **state) {
  (void)state;
  /* K = 12: one = 2047 with the low two bits saying that w (3) is left out; a quarter turn about x. */
  const int16_t in[4] = {2047, 0, 0, (2047 & ~3) | 3};
  int16_t out[4];
  filtered(LOD_MESHOPT_QUATERNION, in, 8, out);
  assert_true(abs(out[0] - 23170) <= 1 && out[1] == 0 && out[2] == 0 && abs(out[3] - 23170) <= 1);
}

static void exponential_floats_are_mantissa_times_power_of_two(void **state) {
  (void)state;
  const int32_t in[3] = {(int32_t)((uint32_t)-3 << 24 | 20), (int32_t)((uint32_t)2 << 24 | (0xFFFFFF & (uint32_t)-5)), 0};
  float out[3];
  filtered(LOD_MESHOPT_EXPONENTIAL, in, 12, out);
  assert_true(out[0] == 2.5f && out[1] == -20 && out[2] == 0);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(attributes_of_every_stride_and_encoding_come_back),
      cmocka_unit_test(the_specifications_example_decodes_to_its_deltas),
      cmocka_unit_test(triangle_codes_follow_the_fifos),
      cmocka_unit_test(indices_follow_two_baselines),
      cmocka_unit_test(every_prefix_of_a_stream_is_refused),
      cmocka_unit_test(wrong_arguments_are_refused),
      cmocka_unit_test(octahedral_normals_have_unit_length_on_both_hemispheres),
      cmocka_unit_test(a_quaternion_gets_its_largest_component_back),
      cmocka_unit_test(exponential_floats_are_mantissa_times_power_of_two),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
