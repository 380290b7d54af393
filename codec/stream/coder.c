#include "codec/stream/coder.h"

#include <string.h>

/* e^x for 0 <= x <= 8, by squaring a short series: + - * / alone, so the same everywhere. */
static double exponential(double x) {
  double y = x / 1024, e = 1 + y * (1 + y / 2 * (1 + y / 3 * (1 + y / 4)));
  for (int i = 0; i < 10; i++)
    e *= e;
  return e;
}

const struct lod_coder_tables *lod_coder_tables_create(struct lod_arena *arena) {
  struct lod_coder_tables *t = LOD_NEW(arena, 1, struct lod_coder_tables);
  if (t == NULL)
    return NULL;
  double high[(LOD_STRETCH_LIMIT + 1) / 64], low[64]; /* e^i of i / 64 and i % 64, for 2048 series would take as long as a small frame */
  for (int i = 0; i < 64; i++)
    low[i] = exponential((double)i / LOD_STRETCH_ONE);
  for (int i = 0; i < (LOD_STRETCH_LIMIT + 1) / 64; i++)
    high[i] = exponential(64.0 * i / LOD_STRETCH_ONE);
  for (int i = 0; i <= LOD_STRETCH_LIMIT; i++) {
    const double e = high[i / 64] * low[i % 64];
    int p = (int)(65536 * e / (1 + e) + 0.5);
    p = p > 65536 - 24 ? 65536 - 24 : p;
    t->squash[LOD_STRETCH_LIMIT + i] = (uint16_t)p;
    t->squash[LOD_STRETCH_LIMIT - i] = (uint16_t)(65536 - p);
  }
  t->squash[2 * LOD_STRETCH_LIMIT + 1] = t->squash[2 * LOD_STRETCH_LIMIT];
  int s = 0;
  for (int p = 0; p < 4096; p++) { /* the largest s whose squash is not above the middle of p's bin */
    while (s < 2 * LOD_STRETCH_LIMIT && t->squash[s + 1] <= p * 16 + 8)
      s++;
    t->stretch[p] = (int16_t)(s - LOD_STRETCH_LIMIT);
  }
  for (int n = 0; n < LOD_DIVISORS; n++)
    t->divisor[n] = (uint16_t)(65536 / (n + 1.5));
  return t;
}

void lod_coder_encode(struct lod_coder *coder, const struct lod_coder_tables *tables, struct lod_arena *arena) {
  *coder = (struct lod_coder){.high = UINT32_MAX, .tables = tables, .arena = arena};
}

void *lod_coder_models(struct lod_coder *c, size_t size, struct lod_arena *arena) {
  const uint32_t kind = c->memory.count++;
  const bool primed = c->primer != NULL && kind < c->primer->count && c->primer->sizes[kind] == size;
  void *block = primed ? lod_arena_copy(arena, c->primer->blocks[kind], size) : lod_arena_calloc(arena, 1, size);
  c->memory.blocks[kind] = block;
  c->memory.sizes[kind] = size;
  return block;
}

struct lod_coder_memory *lod_coder_remember(const struct lod_coder *c, struct lod_arena *arena) {
  struct lod_coder_memory *memory = LOD_NEW(arena, 1, struct lod_coder_memory);
  if (memory == NULL)
    return NULL;
  *memory = c->memory;
  for (uint32_t kind = 0; kind < memory->count; kind++)
    if ((memory->blocks[kind] = lod_arena_copy(arena, c->memory.blocks[kind], memory->sizes[kind])) == NULL)
      return NULL;
  return memory;
}

void lod_coder_decode(struct lod_coder *coder, const struct lod_coder_tables *tables, const uint8_t *bytes, size_t size) {
  *coder = (struct lod_coder){.decoding = true, .high = UINT32_MAX, .tables = tables, .in = bytes, .in_end = bytes + size};
  for (int i = 0; i < 4; i++)
    coder->code = coder->code << 8 | lod_coder_next_byte(coder);
}

void lod_coder_put_byte(struct lod_coder *c, uint32_t byte) {
  if (c->out_size == c->out_capacity) {
    size_t capacity = c->out_capacity == 0 ? 4096 : 2 * c->out_capacity;
    uint8_t *grown = LOD_NEW(c->arena, capacity, uint8_t);
    if (grown == NULL) {
      c->failed = true;
      return;
    }
    if (c->out_size != 0)
      memcpy(grown, c->out, c->out_size);
    c->out = grown;
    c->out_capacity = capacity;
  }
  c->out[c->out_size++] = (uint8_t)byte;
}

/* Enough bytes that whatever a decoder reads behind them is inside [low, high]; it reads zeros there, so trailing zeros need not be sent.
 */
bool lod_coder_finish(struct lod_coder *c) {
  if (c->decoding)
    return c->in == c->in_end && c->overrun <= 4;
  uint32_t value = c->low;
  for (int bytes = 0; bytes <= 4; bytes++) { /* the shortest number in the interval */
    uint32_t mask = bytes == 4 ? 0 : UINT32_MAX >> (8 * bytes);
    uint32_t candidate = (c->low & mask) == 0 ? c->low : (c->low | mask) == UINT32_MAX ? 0 : (c->low | mask) + 1;
    if (candidate >= c->low && candidate <= c->high) {
      value = candidate;
      for (int i = 0; i < bytes; i++)
        lod_coder_put_byte(c, value >> (24 - 8 * i) & 255);
      return !c->failed;
    }
  }
  return false; /* cannot be: low itself has four bytes */
}

uint32_t lod_coder_raw(struct lod_coder *c, uint32_t value, int count) {
  uint32_t result = 0;
  for (int i = count - 1; i >= 0; i--)
    result = result << 1 | (uint32_t)lod_coder_code(c, 32768, value >> i & 1);
  return result;
}

static int bit_length(uint32_t value) {
  int length = 0;
  while (value != 0) {
    length++;
    value >>= 1;
  }
  return length;
}

uint32_t lod_coder_number(struct lod_coder *c, struct lod_number_model *m, uint32_t value) {
  int length = bit_length(value), n = 0;
  while (n < 32 && lod_coder_bit(c, &m->length[n], LOD_ADAPT, length > n))
    n++;
  if (n < 2)
    return (uint32_t)n;
  uint32_t second = (uint32_t)lod_coder_bit(c, &m->first[n], LOD_ADAPT, value >> (n - 2) & 1);
  return (2 | second) << (n - 2) | lod_coder_raw(c, value, n - 2);
}

int32_t lod_coder_signed(struct lod_coder *c, struct lod_number_model *m, struct lod_bit_model *sign, int32_t value) {
  uint32_t magnitude = lod_coder_number(c, m, value < 0 ? 0u - (uint32_t)value : (uint32_t)value);
  if (magnitude == 0)
    return 0;
  bool negative = lod_coder_bit(c, sign, LOD_ADAPT, value < 0);
  return (int32_t)(negative ? 0u - magnitude : magnitude);
}
