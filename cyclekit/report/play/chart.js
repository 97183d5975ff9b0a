// ---- what is played with

const section = document.getElementById("play");
const part = (name) => section.querySelector(`[data-play="${name}"]`);
const made = (tag, className, text) => {
  const element = document.createElement(tag);
  if (className) element.className = className;
  if (text !== undefined) element.textContent = text;
  return element;
};
const state = { number: 0, blocks: [], asked: null, takt_s: facts.takt_s };
const SEQUENCES = told.parts.flatMap((part) => part.facts.sequences.map((sequence) => ({ part, sequence })));

const visitsOf = (rest, asked) => { // a place that comes again and again is fetched from: it moves with what follows
  const often = (place) => rest.filter((each) => each === place).length;
  const goals = new Set();
  const hubs = new Set();
  for (const place of [...new Set(rest)].sort((a, b) => often(b) - often(a))) {
    if (often(place) < 2 || goals.has(place)) continue;
    hubs.add(place);
    rest.forEach((each, n) => { if (rest[n - 1] === place && !hubs.has(each)) goals.add(each); });
  }
  const visits = [];
  let fetched = false;
  rest.forEach((place, n) => {
    if (!(fetched && !hubs.has(place))) visits.push({ places: [], asked: [], on: true });
    visits[visits.length - 1].places.push(place);
    visits[visits.length - 1].asked.push(asked[n]);
    fetched = hubs.has(place);
  });
  return visits;
};
const chained = (agent, places, starts, asked) => { // with the place where the agent begins, and ends if it is the same
  const rest = starts ? places.slice(1) : [...places];
  const end = starts && rest.length > 1 && rest[rest.length - 1] === places[0] ? rest.pop() : null;
  const tasks = asked ? asked[agent] : [];
  const mine = starts && agent === "operator" ? tasks.slice(1) : tasks;
  const [firstAsked, endAsked] = [agent === "operator" && starts ? tasks[0] : null, end === null ? null : tasks[tasks.length - 1]];
  return { agent, first: starts ? places[0] : null, firstAsked, visits: visitsOf(rest, mine), end, endAsked };
};
const blocksOf = (sequence) => { // what each agent does, in order
  if (facts.kind === "list") {
    const agents = [...new Set(sequence.tasks.map((task) => task.asked))];
    return agents.map((agent) => ({
      agent, first: null, end: null, visits: sequence.tasks.filter((task) => task.asked === agent)
        .map((task) => ({ places: [task.name], task, on: true })),
    }));
  }
  const robot = chained("robot", sequence.robot, true, sequence.asked);
  if (facts.kind === "robot" || !sequence.operator) return [robot];
  const { operator } = sequence;
  return [robot, chained("operator", operator, operator.length > 2 && operator[0] === operator[operator.length - 1], sequence.asked)];
};
const playedBy = (block) => [
  ...(block.first === null ? [] : [block.first]),
  ...block.visits.filter((visit) => visit.on).flatMap((visit) => visit.places),
  ...(block.end === null ? [] : [block.end]),
];
const askedBy = (block) => [ // tasks of a plan as it asks for them
  ...(block.firstAsked ? [block.firstAsked] : []),
  ...block.visits.filter((visit) => visit.on).flatMap((visit) => visit.asked),
  ...(block.end === null ? [] : [block.endAsked]),
];
const given = () => SEQUENCES[state.number].sequence;
const played = (blocks) => { // as `answers` take it
  if (facts.kind === "robot") return playedBy(blocks[0]);
  if (facts.kind === "list") return blocks.flatMap((block) => block.visits.filter((visit) => visit.on).map((visit) => visit.task));
  const asked = given().asked ? { robot: askedBy(blocks[0]), operator: blocks[1] ? askedBy(blocks[1]) : [] } : undefined;
  return { robot: playedBy(blocks[0]), operator: blocks[1] ? playedBy(blocks[1]) : null, both: given().both, asked };
};
const tomlOf = () => {
  const quoted = (text) => JSON.stringify(text).replace(/\u007f/g, "\\u007f");
  const several = (texts) => `[${texts.map(quoted).join(", ")}]`;
  const lines = ["[[sequence]]", `name = ${quoted(say("played", { name: given().name }))}`];
  const task = (agent, name, after = [], notBefore_s = undefined) => {
    lines.push("", "[[sequence.task]]", `agent = ${quoted(agent)}`, `name = ${quoted(name)}`);
    if (after.length) lines.push(`after = ${several(after)}`);
    if (notBefore_s !== undefined) lines.push(`not_before_s = ${notBefore_s}`);
  };
  const asked = played(state.blocks);
  if (facts.kind === "list") {
    for (const each of asked) task(each.asked, each.name, each.after, each.not_before_s);
  } else if (asked.asked) {
    const plan = askedOf(asked.robot, asked.asked);
    for (const agent of ["robot", "operator"]) {
      for (const each of plan[agent]) task(agent, each.called, each.comesAfter, each.notBefore_s || undefined);
    }
  } else if (asked.both) {
    asked.robot.slice(1).forEach((place, n) => task("robot", `${asked.robot[n]}->${place}`));
    for (const place of asked.operator) task("operator", place);
  } else {
    lines.push(`places = ${several(asked.robot || asked)}`);
    const operator = asked.operator || facts.operator;
    if (operator) lines.push(`operator = ${several(operator)}`);
  }
  return `${lines.join("\n")}\n`;
};

const apartFrom = (value, before) => {
  const by = shownApart(value, before); // as both are shown
  if (Math.abs(by) < 0.05) return say("same");
  return say(by < 0 ? "shorter" : "longer", { by: fixed(Math.abs(by)) });
};
const waitsOf = (entry, agent) => entry.tasks.filter((task) => (task.asked || task.agent) === agent)
  .reduce((sum, task) => sum + task.wait_s, 0);

const showNumbers = (entry, before) => {
  const known = !entry.unknown;
  part("mean").textContent = known ? say("seconds", { value: fixed(entry.expected_s) }) : say("not_known");
  const around = known ? interval(entry.low_s, entry.high_s) : entry.unknown;
  part("interval").textContent = around;
  part("change").textContent = known && !before.unknown ? apartFrom(entry.expected_s, before.expected_s) : "";
  const [low, , high] = known ? entry.quantiles_s : [];
  const told = {
    single: known && say("range", { span: span(low, high) }),
    safety: known && say("seconds", { value: fixed(entry.safety_s || 0) }),
    support: known && entry.support !== null && percent(entry.support),
    takt: known && entry.takt
      && say("within", { share: percent(entry.takt[0]), interval: percentInterval(entry.takt[1], entry.takt[2]) }),
    waits: known && facts.kind !== "robot"
      && state.blocks.map(({ agent }) => say("waits_of", { agent, value: fixed(waitsOf(entry, agent)) }).replaceAll(" ", "\u00a0")).join(", "),
  };
  for (const [name, text] of Object.entries(told)) part(name).textContent = text || "\u2013";
  const thin = known && entry.support !== null && entry.support < 0.9;
  const doubts = [...(thin ? [say("extrapolated", { share: percent(1 - entry.support) })] : []), ...(entry.ofAll ? [say("of_all", { least: facts.fewest })] : [])];
  part("thin").hidden = !doubts.length;
  part("thin").textContent = doubts.join(" ");
};

const piecesOf = (tasks) => { // of the robot alone: parts one after the other; else the spans of the tasks
  let at = 0;
  return tasks.map((task) => {
    if (task.start_s === undefined) {
      const [motion, slow, dwell, wait] = task.parts;
      const pieces = [["motion", motion], ["slow", slow], ["dwell", dwell], ["wait", wait]];
      const begin = at;
      at += motion + slow + dwell + wait;
      return { ...task, begin, end: at, pieces };
    }
    const long = task.end_s - task.start_s;
    const { nominal_s: motion, lost_s: slow, dwell_s: dwell } = task.share || {};
    const whole = task.share && motion + slow + dwell > 0 ? motion + slow + dwell : 0;
    const kind = facts.kind === "both" ? "person" : { robot: "task", operator: "work" }[facts.agents[task.agent]];
    const work = whole ? [["motion", (motion / whole) * long], ["slow", (slow / whole) * long], ["dwell", (dwell / whole) * long]] : [[kind, long]];
    return { ...task, begin: task.start_s - task.wait_s, end: task.end_s, pieces: [["wait", task.wait_s], ...work] };
  });
};
const lane = (bar, tasks, whole_s) => {
  bar.replaceChildren();
  for (const task of tasks) {
    const texts = [];
    const mine = [];
    let at = task.begin;
    for (const [kind, seconds] of task.pieces) {
      if (seconds < 0.005) continue;
      const piece = made("i", `play-${kind}`);
      piece.style.left = `${(100 * at) / whole_s}%`;
      piece.style.width = `${(100 * seconds) / whole_s}%`;
      at += seconds;
      mine.push(piece);
      texts.push(`${words[kind]} ${fixed(seconds)} s`);
    }
    if (task.after) texts.push(say("decided", { task: task.after, share: percent(task.part) }));
    if (task.ends_s) texts.push(say("ends", { span: span(...task.ends_s) }));
    if (task.logged) texts.push(say("seen", { count: task.logged }));
    const title = `${shown(task.name)}: ${fixed(task.begin)}\u2013${fixed(task.end)} s; ${texts.join("; ")}`;
    for (const piece of mine) piece.title = title;
    bar.append(...mine);
  }
};

const ofTasks = (entry, agent) => { // the spans of each task of an agent
  if (facts.kind === "robot") return piecesOf(entry.tasks).map((task) => [task]);
  const mine = piecesOf(entry.tasks.filter((task) => (task.asked || task.agent) === agent));
  if (facts.kind === "list") return mine.map((task) => [task]);
  const found = [];
  for (const span of mine) (found[span.task] = found[span.task] || []).push(span);
  return found;
};
const showChart = (entry, before) => {
  for (const bar of section.querySelectorAll(".play-lane")) bar.replaceChildren();
  const slowest = Math.max(entry.expected_s || 0, before.expected_s || 0, state.takt_s || 0, 1);
  const every = [1, 2, 5, 10, 20, 30, 60, 120, 300].find((step) => slowest / step <= 7) || 600;
  const whole = Math.ceil(slowest / every) * every;
  for (const axis of section.querySelectorAll(".play-axis")) {
    axis.replaceChildren();
    for (let tick = 0; tick <= whole + NOTHING; tick += every) {
      const mark = made("span", "", tick ? String(tick) : "0 s");
      mark.style.left = `${(100 * tick) / whole}%`;
      axis.append(mark);
    }
  }
  section.style.setProperty("--play-every", `${(100 * every) / whole}%`);
  if (entry.unknown) return;
  for (const block of state.blocks) {
    const tasks = ofTasks(entry, block.agent);
    let first = 0;
    if (block.agent === "operator" && block.first !== null) {
      lane(block.start.querySelector(".play-lane"), tasks[0] || [], whole);
      first = 1;
    }
    for (const item of block.list.children) {
      const visit = block.visits[Number(item.dataset.visit)];
      if (!visit.on) continue;
      const mine = tasks.slice(first, first + visit.places.length).flat();
      lane(item.querySelector(".play-lane"), mine, whole);
      if (!mine.length) item.querySelector(".play-lane").append(made("small", "", say("after_end")));
      first += visit.places.length;
    }
    if (block.end !== null) lane(block.last.querySelector(".play-lane"), tasks.slice(first).flat(), whole);
  }
};
