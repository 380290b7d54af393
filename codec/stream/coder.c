#include "codec/stream/coder.h"

#include <string.h>

enum { STRETCH_LIMIT = 2047, STRETCH_ONE = 256 /* of ln(p / (1 - p)) */, DIVISORS = 1024 + 2 };

struct lod_coder_tables {
  int16_t stretch[4096];                  /* of a probability of 12 bits */
  uint16_t squash[2 * STRETCH_LIMIT + 2]; /* its inverse, with 16 bits */
  uint16_t divisor[DIVISORS];             /* 65536 / (n + 1.5) */
};

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
  for (int i = 0; i <= STRETCH_LIMIT; i++) {
    double e = exponential((double)i / STRETCH_ONE);
    int p = (int)(65536 * e / (1 + e) + 0.5);
    p = p > 65536 - 24 ? 65536 - 24 : p;
    t->squash[STRETCH_LIMIT + i] = (uint16_t)p;
    t->squash[STRETCH_LIMIT - i] = (uint16_t)(65536 - p);
  }
  t->squash[2 * STRETCH_LIMIT + 1] = t->squash[2 * STRETCH_LIMIT];
  int s = 0;
  for (int p = 0; p < 4096; p++) { /* the largest s whose squash is not above the middle of p's bin */
    while (s < 2 * STRETCH_LIMIT && t->squash[s + 1] <= p * 16 + 8)
      s++;
    t->stretch[p] = (int16_t)(s - STRETCH_LIMIT);
  }
  for (int n = 0; n < DIVISORS; n++)
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

static inline uint32_t next_byte(struct lod_coder *c) {
  if (c->in < c->in_end)
    return *c->in++;
  c->overrun += c->overrun < 1000;
  return 0;
}

void lod_coder_decode(struct lod_coder *coder, const struct lod_coder_tables *tables, const uint8_t *bytes, size_t size) {
  *coder = (struct lod_coder){.decoding = true, .high = UINT32_MAX, .tables = tables, .in = bytes, .in_end = bytes + size};
  for (int i = 0; i < 4; i++)
    coder->code = coder->code << 8 | next_byte(coder);
}

static void put_byte(struct lod_coder *c, uint32_t byte) {
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
        put_byte(c, value >> (24 - 8 * i) & 255);
      return !c->failed;
    }
  }
  return false; /* cannot be: low itself has four bytes */
}

/* p: probability of 1, in (0, 65536). */
static inline int code(struct lod_coder *c, uint32_t p, int bit) {
  uint32_t middle = c->low + (uint32_t)(((uint64_t)(c->high - c->low) * p) >> 16);
  if (c->decoding)
    bit = c->code <= middle;
  if (bit)
    c->high = middle;
  else
    c->low = middle + 1;
  while (((c->low ^ c->high) >> 24) == 0) {
    if (c->decoding)
      c->code = c->code << 8 | next_byte(c);
    else
      put_byte(c, c->high >> 24);
    c->low <<= 8;
    c->high = c->high << 8 | 255;
  }
  return bit;
}

static inline uint32_t probability(const struct lod_bit_model *m) {
  return (uint16_t)(m->skew + 32768u);
}

static inline void learn(const struct lod_coder *c, struct lod_bit_model *m, int limit, int bit) {
  const uint32_t p = probability(m), way = bit ? 65535 - 16 - p : p - 16, by = way * c->tables->divisor[m->count] >> 16; /* below 2^32 */
  m->skew = (uint16_t)((bit ? p + by : p - by) - 32768);
  m->count = (uint16_t)(m->count + (m->count < limit));
}

int lod_coder_bit(struct lod_coder *c, struct lod_bit_model *m, int limit, int bit) {
  uint32_t p = probability(m);
  p = p < 16 ? 16 : p;
  bit = code(c, p, bit);
  learn(c, m, limit, bit);
  return bit;
}

/* `count` is known where this is inlined, so that loops unroll. Sums fit: 6 inputs of 2047 times weights of 157286 at most. */
static inline int mix(struct lod_coder *c, struct lod_bit_model *const *models, int count, struct lod_mixer *mixer, int limit, int bit) {
  int32_t inputs[LOD_MIX_INPUTS], sum = 0;
  for (int i = 0; i < count; i++) {
    inputs[i] = c->tables->stretch[probability(models[i]) >> 4];
    sum += inputs[i] * (mixer->weights[i] + 65536 * 2 / 5);
  }
  int32_t s = sum / 65536;
  s = s > STRETCH_LIMIT ? STRETCH_LIMIT : s < -STRETCH_LIMIT ? -STRETCH_LIMIT : s;
  uint32_t p = c->tables->squash[s + STRETCH_LIMIT];
  bit = code(c, p, bit);
  int32_t error = (bit ? 65536 : 0) - (int32_t)p;
  for (int i = 0; i < count; i++) {
    int32_t w = mixer->weights[i] + inputs[i] * error / 16384; /* rate about 0.004 */
    mixer->weights[i] = w > 131072 ? 131072 : w < -131072 ? -131072 : w;
    learn(c, models[i], limit, bit);
  }
  return bit;
}

int lod_coder_mix(struct lod_coder *c, struct lod_bit_model *const *models, int count, struct lod_mixer *mixer, int limit, int bit) {
  switch (count) {
  case 2:
    return mix(c, models, 2, mixer, limit, bit);
  case 3:
    return mix(c, models, 3, mixer, limit, bit);
  case 4:
    return mix(c, models, 4, mixer, limit, bit);
  case 5:
    return mix(c, models, 5, mixer, limit, bit);
  default:
    return mix(c, models, count, mixer, limit, bit);
  }
}

uint32_t lod_coder_raw(struct lod_coder *c, uint32_t value, int count) {
  uint32_t result = 0;
  for (int i = count - 1; i >= 0; i--)
    result = result << 1 | (uint32_t)code(c, 32768, value >> i & 1);
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
