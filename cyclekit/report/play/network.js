// ---- a network, evaluated at one position at a time: `Weights._block` of one row

// One layer in WebAssembly, which takes a sixth of the script's time: first the inputs that are not 0 (half of them are),
// from `x` to `xEnd`, go into a list of value and place of its weights; then the outputs are summed up, 32 at once.
// The arguments are addresses: per 32 outputs a block of their biases, then of their weights for each input, from `w` on;
// outputs from `out` to `outEnd`, none of them below `least`; room for the list from `list` on.
const [I32, F32, V128, EMPTY] = [0x7f, 0x7d, 0x7b, 0x40];
const [X, X_END, W, OUT, OUT_END, LEAST, LIST, AT, PLACE, END, ROW, VALUE, SUM] = Array.from({ length: 13 }, (_, n) => n);
const LANES = 32; // outputs of one block: eight sums of four
const BLOCK = 4 * LANES; // bytes
const layerCode = () => {
  const get = (name) => [0x20, name];
  const set = (name, code) => [...code, 0x21, name];
  const vector = (code, ...more) => [0xfd, code, ...more];
  const load = (name, offset) => [...get(name), ...vector(0x00, 4, offset)];
  const [add, mul, most] = [0xe4, 0xe6, 0xe9].map((code) => vector(code, 1));
  const number = (value) => [0x41, (value & 0x7f) | 0x80, value >> 7];
  const plus = (name, code) => set(name, [...get(name), ...code, 0x6a]);
  const until = (name, end, code) => [0x03, EMPTY, ...code, ...get(name), ...get(end), 0x49, 0x0d, 0, 0x0b];
  const input = [...get(X), 0x2a, 2, 0];
  const sums = Array.from({ length: LANES / 4 }, (_, n) => n);
  return [
    ...set(PLACE, number(BLOCK)),
    ...set(END, get(LIST)),
    ...until(X, X_END, [
      ...get(END), ...input, 0x38, 2, 0,
      ...get(END), ...get(PLACE), 0x36, 2, 4,
      ...plus(END, [...input, 0x43, 0, 0, 0, 0, 0x5c, ...number(3), 0x74]), // stays where the input is 0
      ...plus(PLACE, number(BLOCK)),
      ...plus(X, number(4)),
    ]),
    ...until(OUT, OUT_END, [
      ...sums.flatMap((n) => set(SUM + n, load(W, 16 * n))),
      ...set(AT, get(LIST)),
      ...until(AT, END, [
        ...set(VALUE, [...get(AT), ...vector(0x09, 2, 0)]), // one input, four times
        ...set(ROW, [...get(W), ...get(AT), 0x28, 2, 4, 0x6a]),
        ...sums.flatMap((n) => set(SUM + n, [...get(SUM + n), ...get(VALUE), ...load(ROW, 16 * n), ...mul, ...add])),
        ...plus(AT, number(8)),
      ]),
      ...sums.flatMap((n) => [
        ...get(OUT), ...get(SUM + n), ...get(LEAST), ...vector(0x13), ...most, ...vector(0x0b, 4, 16 * n),
      ]),
      ...plus(W, get(PLACE)), // all inputs were counted: one more than them
      ...plus(OUT, number(BLOCK)),
    ]),
  ];
};
const layerModule = (pages) => {
  const body = [2, 4, I32, 1 + LANES / 4, V128, ...layerCode(), 0x0b];
  const long = (value) => [(value & 0x7f) | 0x80, value >> 7];
  const section = (number, ...bytes) => [number, ...long(bytes.length), ...bytes];
  return new Uint8Array([
    0, 0x61, 0x73, 0x6d, 1, 0, 0, 0,
    ...section(1, 1, 0x60, 7, I32, I32, I32, I32, I32, F32, I32, 0),
    ...section(3, 1, 0),
    ...section(5, 1, 0, ...long(pages)),
    ...section(7, 2, 1, 109, 2, 0, 1, 102, 0, 0), // "m": the memory, "f": the function
    ...section(10, 1, ...long(body.length), ...body),
  ]);
};

const layersOf = (widths) => {
  let at = 0;
  return widths.slice(1).map((to, n) => {
    const from = widths[n];
    const weight = tables.weights.subarray(at, at + from * to);
    const bias = tables.weights.subarray(at + from * to, at + (from + 1) * to);
    at += (from + 1) * to;
    return { from, to, weight, bias };
  });
};

const quickLayers = (layers) => { // layers in WebAssembly; null where the browser has none
  const padded = (width) => LANES * Math.ceil(width / LANES);
  const room = Math.max(...layers.flatMap(({ from, to }) => [padded(from), padded(to)]));
  const size = 5 * room + layers.reduce((sum, { from, to }) => sum + padded(to) * (from + 1), 0);
  let made;
  try {
    made = new WebAssembly.Instance(new WebAssembly.Module(layerModule(Math.ceil((4 * size) / 65536)))).exports;
  } catch {
    return null;
  }
  const memory = new Float32Array(made.m.buffer);
  let end = 5 * room; // after the inputs, two rooms for what a layer gives, and the list
  const list = 12 * room;
  return {
    inputs: memory.subarray(0, layers[0].from),
    steps: layers.map(({ from, to, weight, bias }, n) => {
      const begin = end;
      for (let block = 0; block < to; block += LANES) {
        for (let o = block; o < Math.min(block + LANES, to); o += 1) {
          memory[end + o - block] = bias[o];
          for (let i = 0; i < from; i += 1) memory[end + LANES * (i + 1) + o - block] = weight[i * to + o];
        }
        end += LANES * (from + 1);
      }
      const [x, out] = [n ? room * (2 - (n % 2)) : 0, room * (1 + (n % 2))];
      const at = [x, x + from, begin, out, out + padded(to)].map((place) => 4 * place);
      const [x0, x1, w, out0, out1] = at; // a call with them spread takes several times as long
      return { out: memory.subarray(out, out + to), run: (least) => made.f(x0, x1, w, out0, out1, least, list) };
    }),
  };
};

const plainLayers = (layers) => { // the same in the script
  const inputs = new Float64Array(layers[0].from);
  let x = inputs;
  return {
    inputs,
    steps: layers.map(({ to, weight, bias }) => {
      const given = x;
      const out = new Float64Array(to);
      x = out;
      const run = (least) => {
        out.set(bias);
        for (let i = 0; i < given.length; i += 1) {
          const value = given[i];
          if (value !== 0) for (let o = 0, at = i * to; o < to; o += 1, at += 1) out[o] += value * weight[at];
        }
        for (let o = 0; o < to; o += 1) if (out[o] < least) out[o] = least;
      };
      return { out, run };
    }),
  };
};

const networkOf = () => { // its outputs for TCP and operator, m
  const { widths, known, distance, softmax_after: softmaxAfter } = facts.rule.network;
  const layers = layersOf(widths);
  const { inputs, steps } = quickLayers(layers) || plainLayers(layers);
  const last = steps.length - 1;
  inputs.fill(1, 6, 6 + known); // known: the TCP always, an operator who is asked about
  return (r, h) => {
    for (let axis = 0; axis < 3; axis += 1) {
      inputs[axis] = r[axis];
      inputs[3 + axis] = h[axis];
    }
    if (distance) inputs[6 + known] = apart(TO_TCP, r, h);
    for (let n = 0; n <= last; n += 1) {
      const { out, run } = steps[n];
      run(n === softmaxAfter || n === last ? -Infinity : 0);
      if (n !== softmaxAfter) continue;
      let most = -Infinity;
      for (let o = 0; o < out.length; o += 1) if (out[o] > most) most = out[o];
      let sum = 0;
      for (let o = 0; o < out.length; o += 1) sum += (out[o] = Math.exp(out[o] - most));
      for (let o = 0; o < out.length; o += 1) out[o] /= sum;
    }
    return steps[last].out;
  };
};

