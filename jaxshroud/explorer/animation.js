// Show one frame of `frames`: the corners of both blocks, and the forces on the right block where they touch.
const f = frames.data, i = Math.round(frame.value);
const quiet = { sync: false }; // the server need not know
if (f.x00 !== undefined && f.t.length > i) {
  const of_block = (axis, b) => [0, 1, 2, 3].map((k) => f[`${axis}${b}${k}`][i]);
  const data = { xs: [of_block("x", 0), of_block("x", 1)], ys: [of_block("y", 0), of_block("y", 1)], blade: [0, 1] };
  blocks.setv({ data }, quiet);
  const touching = Number.isFinite(f.px[i]);
  const ends = touching
    ? { x0: [f.px[i], f.px[i]], y0: [f.py[i], f.py[i]], x1: [f.nx[i], f.fx[i]], y1: [f.ny[i], f.fy[i]] }
    : { x0: [], y0: [], x1: [], y1: [] };
  arrows.setv({ data: ends }, quiet);
  title.setv({ text: `${title.text.split(" · ")[0]} · t/T = ${f.t[i].toFixed(2)}, ${f.state[i]}` }, quiet);
}
