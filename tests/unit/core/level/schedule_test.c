#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include "core/level/schedule.h"
#include "tests/data/shapes.h"

enum { LEVELS = 6, MANY = 200 };

/* Triangles double, errors fall by sqrt(2), as clustering does. */
static const struct lod_level_facts kLadder[LEVELS] = {
    {.error = 0.08, .triangles = 100, .bytes = 1000},   {.error = 0.056, .triangles = 200, .bytes = 1900},
    {.error = 0.04, .triangles = 400, .bytes = 3700},   {.error = 0.028, .triangles = 800, .bytes = 7000},
    {.error = 0.02, .triangles = 1600, .bytes = 13000}, {.error = 0.014, .triangles = 3200, .bytes = 25000},
};

static struct lod_schedule_object object_at(double distance, double importance) {
  return (struct lod_schedule_object){kLadder, LEVELS, {distance, 60, 1080}, importance};
}

static void the_nearer_of_two_objects_gets_the_finer_level(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_schedule_object objects[2] = {object_at(100, 1), object_at(5, 1)};
  struct lod_schedule_settings settings = lod_schedule_defaults();
  uint32_t chosen[2] = {UINT32_MAX, UINT32_MAX};
  uint64_t cost;
  settings.budget = 2000;
  assert_int_equal(lod_schedule_choose(objects, 2, &settings, arena, chosen, &cost, NULL), LOD_OK);
  assert_true(chosen[1] > chosen[0]);
  assert_true(cost <= 2000);
  assert_int_equal(cost, kLadder[chosen[0]].triangles + kLadder[chosen[1]].triangles);
  lod_arena_destroy(arena);
}

static void nothing_finer_than_enough_is_taken_even_with_room(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_schedule_object object = object_at(60, 1);
  struct lod_schedule_settings settings = lod_schedule_defaults();
  uint32_t chosen = UINT32_MAX;
  assert_int_equal(lod_schedule_choose(&object, 1, &settings, arena, &chosen, NULL, NULL), LOD_OK);
  assert_true(lod_screen_error_px(kLadder[chosen].error, &object.view) <= settings.enough_px);
  assert_true(chosen > 0 && lod_screen_error_px(kLadder[chosen - 1].error, &object.view) > settings.enough_px);
  lod_arena_destroy(arena);
}

static void out_of_sight_takes_the_coarsest_and_a_budget_of_nothing_takes_all_coarsest(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_schedule_object objects[2] = {object_at(2, 0), object_at(2, 1)};
  struct lod_schedule_settings settings = lod_schedule_defaults();
  uint32_t chosen[2] = {5, 5};
  assert_int_equal(lod_schedule_choose(objects, 2, &settings, arena, chosen, NULL, NULL), LOD_OK);
  assert_int_equal(chosen[0], 0);
  assert_int_equal(chosen[1], 5);
  settings.budget = 0;
  assert_int_equal(lod_schedule_choose(objects, 2, &settings, arena, chosen, NULL, NULL), LOD_OK);
  assert_int_equal(chosen[0], 0);
  assert_int_equal(chosen[1], 0);
  lod_arena_destroy(arena);
}

/* All combinations of three objects: greedy is short of the best by at most one step. */
static void greedy_is_close_to_the_best_of_all_combinations(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  uint64_t random = 11;
  for (int round = 0; round < 200; round++) {
    struct lod_schedule_object o[3];
    double importance = 0;
    for (int i = 0; i < 3; i++) {
      o[i] = object_at(1 + 30 * lod_random_unit(&random), 0.2 + lod_random_unit(&random));
      importance = fmax(importance, o[i].importance);
    }
    struct lod_schedule_settings settings = lod_schedule_defaults();
    settings.budget = 300 + (uint64_t)(8000 * lod_random_unit(&random));
    settings.hysteresis = 0;
    settings.enough_px = 0;
    uint32_t chosen[3] = {UINT32_MAX, UINT32_MAX, UINT32_MAX};
    double benefit, best = 0, widest = 0;
    uint64_t cost;
    assert_int_equal(lod_schedule_choose(o, 3, &settings, arena, chosen, &cost, &benefit), LOD_OK);
    assert_true(cost <= settings.budget);
    for (uint32_t c = 0; c < LEVELS * LEVELS * LEVELS; c++) {
      uint32_t l[3] = {c % LEVELS, c / LEVELS % LEVELS, c / LEVELS / LEVELS};
      double b = 0;
      uint64_t sum = 0;
      for (int i = 0; i < 3; i++) {
        b += lod_schedule_benefit(&o[i], l[i]);
        sum += kLadder[l[i]].triangles;
      }
      best = sum <= settings.budget ? fmax(best, b) : best;
    }
    for (int i = 0; i < 3; i++)
      for (uint32_t l = 1; l < LEVELS; l++)
        widest = fmax(widest, lod_schedule_benefit(&o[i], l) - lod_schedule_benefit(&o[i], l - 1));
    assert_true(benefit <= best * (1 + 1e-12));
    assert_true(benefit >= best - widest * (1 + 1e-12));
  }
  lod_arena_destroy(arena);
}

/* A camera that trembles back and forth by 2 %: with hysteresis no level changes after the first frames, without it some do. */
static int count_changes(double hysteresis) {
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_schedule_object objects[MANY];
  uint32_t chosen[MANY], last[MANY];
  int changes = 0;
  for (uint32_t i = 0; i < MANY; i++)
    chosen[i] = UINT32_MAX;
  struct lod_schedule_settings settings = lod_schedule_defaults();
  settings.budget = 80000;
  settings.hysteresis = hysteresis;
  for (int frame = 0; frame < 20; frame++) {
    for (uint32_t i = 0; i < MANY; i++)
      objects[i] = object_at((2 + 0.2 * i) * ((frame + (int)i) % 2 ? 1.02 : 1), 1);
    for (uint32_t i = 0; i < MANY; i++)
      last[i] = chosen[i];
    uint64_t cost;
    assert_int_equal(lod_schedule_choose(objects, MANY, &settings, arena, chosen, &cost, NULL), LOD_OK);
    assert_true(cost <= settings.budget);
    for (uint32_t i = 0; i < MANY; i++)
      changes += frame >= 4 && last[i] != chosen[i];
  }
  lod_arena_destroy(arena);
  return changes;
}

static void hysteresis_keeps_levels_from_toggling(void **state) {
  (void)state;
  assert_int_equal(count_changes(0.25), 0);
  assert_true(count_changes(0) > 0);
}

static void starting_from_the_last_frame_is_as_good_as_starting_afresh(void **state) {
  (void)state;
  struct lod_arena *arena = lod_arena_create(0);
  struct lod_schedule_settings settings = lod_schedule_defaults();
  settings.hysteresis = 0;
  settings.budget = 60000;
  struct lod_schedule_object objects[MANY];
  uint32_t kept[MANY], fresh[MANY];
  for (uint32_t i = 0; i < MANY; i++)
    kept[i] = UINT32_MAX;
  for (int frame = 0; frame < 10; frame++) {
    double a, b;
    for (uint32_t i = 0; i < MANY; i++) {
      objects[i] = object_at(1 + fabs(0.2 * i - 4.0 * frame), 1);
      fresh[i] = UINT32_MAX;
    }
    assert_int_equal(lod_schedule_choose(objects, MANY, &settings, arena, kept, NULL, &a), LOD_OK);
    assert_int_equal(lod_schedule_choose(objects, MANY, &settings, arena, fresh, NULL, &b), LOD_OK);
    assert_true(fabs(a - b) <= 0.01 * b);
  }
  lod_arena_destroy(arena);
}

int main(void) {
  const struct CMUnitTest tests[] = {
      cmocka_unit_test(the_nearer_of_two_objects_gets_the_finer_level),
      cmocka_unit_test(nothing_finer_than_enough_is_taken_even_with_room),
      cmocka_unit_test(out_of_sight_takes_the_coarsest_and_a_budget_of_nothing_takes_all_coarsest),
      cmocka_unit_test(greedy_is_close_to_the_best_of_all_combinations),
      cmocka_unit_test(hysteresis_keeps_levels_from_toggling),
      cmocka_unit_test(starting_from_the_last_frame_is_as_good_as_starting_afresh),
  };
  return cmocka_run_group_tests(tests, NULL, NULL);
}
