// ---- what is drawn: numpy's default generator (PCG64 seeded by SeedSequence), so that draws are those of the library

const CRC = Uint32Array.from({ length: 256 }, (_, n) => {
  let value = n;
  for (let bit = 0; bit < 8; bit += 1) value = value & 1 ? 0xedb88320 ^ (value >>> 1) : value >>> 1;
  return value;
});
const crc32 = (text) => {
  let value = -1;
  for (const byte of new TextEncoder().encode(text)) value = CRC[(value ^ byte) & 255] ^ (value >>> 8);
  return ~value >>> 0;
};

const seeded = (entropy) => { // SeedSequence(entropy).generate_state(8)
  let constant = 0x43b0d7e5;
  const hashed = (value, by) => {
    let found = value ^ constant;
    constant = Math.imul(constant, by);
    found = Math.imul(found, constant);
    return (found ^ (found >>> 16)) >>> 0;
  };
  const mixed = (one, other) => {
    const found = Math.imul(0xca01f9dd, one) - Math.imul(0x4973f715, other);
    return (found ^ (found >>> 16)) >>> 0;
  };
  const pool = [0, 1, 2, 3].map((n) => hashed(n < entropy.length ? entropy[n] : 0, 0x931e8875));
  for (let from = 0; from < 4; from += 1) {
    for (let to = 0; to < 4; to += 1) if (from !== to) pool[to] = mixed(pool[to], hashed(pool[from], 0x931e8875));
  }
  for (const more of entropy.slice(4)) for (let to = 0; to < 4; to += 1) pool[to] = mixed(pool[to], hashed(more, 0x931e8875));
  constant = 0x8b51f9dd;
  return Array.from({ length: 8 }, (_, n) => hashed(pool[n % 4], 0x58f38ded));
};

const TIMES = [0xf645, 0x9fcc, 0xdf64, 0x4385, 0x5da4, 0x1fc6, 0xed05, 0x2360]; // 128 bits, 16 at a time
const generator = (...entropy) => {
  const words = seeded(entropy).flatMap((word) => [word & 0xffff, word >>> 16]);
  const [begin, odd] = [0, 8].map((from) => [...words.slice(from + 4, from + 8), ...words.slice(from, from + 4)]);
  const inc = odd.map((limb, n) => ((limb << 1) | (n ? odd[n - 1] >>> 15 : 1)) & 0xffff);
  let [state, next] = [new Float64Array(8), new Float64Array(8)];
  const add = (other) => {
    let carry = 0;
    for (let n = 0; n < 8; n += 1) {
      const sum = state[n] + other[n] + carry;
      state[n] = sum & 0xffff;
      carry = sum > 0xffff ? 1 : 0;
    }
  };
  const step = () => {
    let carry = 0;
    for (let n = 0; n < 8; n += 1) {
      let sum = carry + inc[n];
      for (let i = 0; i <= n; i += 1) sum += state[i] * TIMES[n - i];
      carry = Math.floor(sum / 65536);
      next[n] = sum - 65536 * carry;
    }
    [state, next] = [next, state];
  };
  add(inc);
  add(begin);
  step();
  let second = null; // the upper half of what was drawn last
  const word = () => {
    if (second !== null) {
      const found = second;
      second = null;
      return found;
    }
    step();
    const half = (n) => ((state[n] ^ state[n + 4]) | ((state[n + 1] ^ state[n + 5]) << 16)) >>> 0;
    let [low, high] = [half(0), half(2)];
    const turn = state[7] >>> 10;
    if (turn & 32) [low, high] = [high, low];
    const by = turn & 31;
    if (by) [low, high] = [(low >>> by) | (high << (32 - by)), (high >>> by) | (low << (32 - by))];
    second = high >>> 0;
    return low >>> 0;
  };
  const below = (count) => { // Generator.integers: from 0 up to, not including, `count` (at most 2 ** 20)
    if (count < 2) return 0;
    const least = (4294967296 - count) % count;
    for (;;) {
      const product = word() * count;
      const whole = Math.floor(product / 4294967296);
      const left = product - 4294967296 * whole;
      if (left >= least) return whole;
    }
  };
  const upTo = (most) => { // as `shuffle` draws: from 0 up to `most`
    const mask = 2 ** (32 - Math.clz32(most)) - 1;
    for (;;) {
      const found = (word() & mask) >>> 0;
      if (found <= most) return found;
    }
  };
  const shuffled = (found) => {
    for (let n = found.length - 1; n > 0; n -= 1) {
      const other = upTo(n);
      [found[n], found[other]] = [found[other], found[n]];
    }
    return found;
  };
  return { below, shuffled };
};

const LEVELS = new Map();
const levelsOf = (key, turn) => { // Drawn._level: in (0, 1), spread evenly over the cycles and shuffled
  const name = `${turn} ${key}`;
  if (!LEVELS.has(name)) {
    const { shuffled } = generator(facts.seed, crc32(key), turn);
    LEVELS.set(name, shuffled(Float64Array.from({ length: facts.cycles }, (_, n) => (n + 0.5) / facts.cycles)));
  }
  return LEVELS.get(name);
};
const shareOf = (values, spread) => { // Levels.share_of: correlation with what durations of one cycle share
  if (!spread) return 0;
  const middle = quantile(sorted(values), 0.5);
  if (middle <= 0) return 0;
  const { outlier, most } = facts.common;
  const logs = Float64Array.from(values, (value) => Math.log(Math.min(Math.max(value / middle, 1 / outlier), outlier)));
  const own = Math.sqrt((covariance(logs, logs) * (logs.length - 1)) / logs.length);
  return own > 1e-6 ? Math.round(1000 * Math.min(spread / own, most)) / 1000 : 0;
};
const scoresOf = (key, turn) => levelsOf(key, turn).map((level) => tables.normal[Math.floor(level * facts.cycles)]);
const sharedOf = (walks = !facts.common.work) => { // Levels.shared
  const { keys, work, together } = facts.common;
  const mine = scoresOf(keys[walks ? 1 : 0], 0);
  if (!walks || !work) return mine;
  const other = sharedOf(false);
  return mine.map((score, n) => together * other[n] + Math.sqrt(1 - together ** 2) * score);
};
const levelsAlike = (key, turn, share, walks = false) => { // Levels.alike
  if (!share) return levelsOf(key, turn);
  const name = `${turn} ${key} ${fixed(share, 6)} ${walks}`;
  if (!LEVELS.has(name)) {
    const shared = sharedOf(walks);
    const scores = scoresOf(key, turn).map((score, n) => share * shared[n] + Math.sqrt(1 - share ** 2) * score);
    const found = new Float64Array(facts.cycles);
    Array.from(scores.keys()).sort((a, b) => scores[a] - scores[b]).forEach((cycle, rank) => { found[cycle] = (rank + 0.5) / facts.cycles; });
    LEVELS.set(name, found);
  }
  return LEVELS.get(name);
};
