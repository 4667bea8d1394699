// What the gateway saw in a frame, drawn over the picture of that very frame. The geometry is pure; `draw` paints.
//
// Pixel centres lie at integers: the centre of the top left pixel is (0, 0), its corner (-0.5, -0.5).

import { known } from './format.js';

/**
 * Scale of a picture, and where a point of the frame lies on it.
 * @param {number} frameWidth of the frame, px @param {number} frameHeight @param {number} width of the canvas, px
 * @param {number} height
 */
export function fit(frameWidth, frameHeight, width, height) {
  const scale = Math.min(width / frameWidth, height / frameHeight);
  const left = (width - frameWidth * scale) / 2;
  const top = (height - frameHeight * scale) / 2;
  return { scale, left, top, x: (u) => left + (u + 0.5) * scale, y: (v) => top + (v + 0.5) * scale };
}

/** @typedef {[number, number]} Point in pixels of the canvas */

/**
 * The arrow from the marker to the aim point, cut off short of both; null where it would be no longer than its head.
 * @param {Point} from @param {Point} to @param {number} gap @param {number} head
 * @returns {{start: Point, back: Point, tip: Point, left: Point, right: Point}|null}
 */
export function arrow(from, to, gap, head) {
  const [dx, dy] = [to[0] - from[0], to[1] - from[1]];
  const length = Math.hypot(dx, dy);
  if (!(length > 2 * gap + head)) return null;
  const [ex, ey] = [dx / length, dy / length];
  /** @type {Point} */
  const start = [from[0] + ex * gap, from[1] + ey * gap];
  /** @type {Point} */
  const tip = [to[0] - ex * gap, to[1] - ey * gap];
  /** @type {Point} */
  const back = [tip[0] - ex * head, tip[1] - ey * head];
  const side = [-ey * head * 0.5, ex * head * 0.5];
  return { start, back, tip, left: [back[0] + side[0], back[1] + side[1]], right: [back[0] - side[0], back[1] - side[1]] };
}

const INK = 'rgba(0,0,0,0.75)';
const RIM = '#ffffff';
const AIM = '#8fd3ff';

/**
 * Paints over a picture: aim with its tolerance, rim, centre, offset. Draws nothing that was not seen in this frame.
 * @param {CanvasRenderingContext2D} g
 * @param {import('./views.js').FrameView|null} view of this very frame; null: not known (yet)
 * @param {{u_px: number|null, v_px: number|null, tolerance_px: number|null}|null} aim
 * @param {{width: number, height: number}} frame size of the frame, px
 */
export function draw(g, view, aim, frame, ratio = 1) {
  const { width, height } = g.canvas;
  g.clearRect(0, 0, width, height);
  if (!(frame.width > 0 && frame.height > 0)) return;
  const place = fit(frame.width, frame.height, width, height);
  const wide = Math.max(1.5 * ratio, width / 420);
  const stroke = (colour, dashes, trace) => {
    g.setLineDash(dashes.map((n) => n * wide));
    for (const [paint, extra] of [[INK, 1.6 * ratio], [colour, 0]]) {
      g.strokeStyle = paint;
      g.lineWidth = wide + extra;
      g.beginPath();
      trace();
      g.stroke();
    }
    g.setLineDash([]);
  };
  if (aim && known(aim.u_px)) paintAim(g, aim, frame, place, wide, stroke);
  const seen = view?.circle ?? null;
  const shown = seen ?? view?.predicted ?? null;
  if (!shown) return;
  /** @type {Point} */
  const centre = [place.x(shown.u), place.y(shown.v)];
  const radius = Math.max(0, shown.radius * place.scale);
  const rim = seen && view.ellipse;
  stroke(RIM, seen ? [] : [4, 4], () => {
    if (rim) g.ellipse(place.x(rim.u), place.y(rim.v), rim.major * place.scale, rim.minor * place.scale, rim.angle, 0, 2 * Math.PI);
    else g.arc(centre[0], centre[1], radius, 0, 2 * Math.PI);
  });
  const arm = Math.max(5 * ratio, Math.min(0.16 * radius, 18 * ratio));
  stroke(RIM, [], () => {
    g.moveTo(centre[0] - arm, centre[1]);
    g.lineTo(centre[0] + arm, centre[1]);
    g.moveTo(centre[0], centre[1] - arm);
    g.lineTo(centre[0], centre[1] + arm);
  });
  if (seen && aim && known(aim.u_px)) {
    /** @type {Point} */
    const target = [place.x(aim.u_px), known(aim.v_px) ? place.y(aim.v_px) : centre[1]];
    const line = arrow(centre, target, 4 * ratio, Math.max(9 * ratio, 4 * wide));
    if (line) {
      stroke(AIM, [], () => {
        g.moveTo(...line.start);
        g.lineTo(...line.back);
      });
      g.fillStyle = AIM;
      g.strokeStyle = INK;
      g.lineWidth = ratio;
      g.beginPath();
      g.moveTo(...line.tip);
      g.lineTo(...line.left);
      g.lineTo(...line.right);
      g.closePath();
      g.fill();
      g.stroke();
    }
  }
}

function paintAim(g, aim, frame, place, wide, stroke) {
  const x = place.x(aim.u_px);
  const bottom = place.top + frame.height * place.scale;
  if (known(aim.tolerance_px) && aim.tolerance_px > 0) {
    const half = aim.tolerance_px * place.scale;
    g.fillStyle = 'rgba(143,211,255,0.08)';
    g.fillRect(x - half, place.top, 2 * half, bottom - place.top);
    stroke(AIM, [2, 3], () => {
      for (const side of [x - half, x + half]) {
        g.moveTo(side, place.top);
        g.lineTo(side, bottom);
      }
    });
  }
  if (!known(aim.v_px)) return;
  const y = place.y(aim.v_px);
  const arm = 5 * wide;
  stroke(AIM, [], () => {
    g.arc(x, y, 0.55 * arm, 0, 2 * Math.PI);
    for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) {
      g.moveTo(x + 0.55 * arm * dx, y + 0.55 * arm * dy);
      g.lineTo(x + 1.5 * arm * dx, y + 1.5 * arm * dy);
    }
  });
}
