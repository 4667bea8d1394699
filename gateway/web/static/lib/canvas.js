// What the plots on a canvas share: its size in the display's own pixels, its font, and the hatching of what is not known.

import { colour } from './theme.js';

export const FONT = "'Segoe UI', Roboto, 'Noto Sans', 'Liberation Sans', sans-serif";

/** How much larger than usual the viewer has text. */
export const textScale = () => parseFloat(getComputedStyle(document.documentElement).fontSize) / 16;

/** An empty canvas of as many pixels as it has on the display. `ratio`: of these to a pixel of the page. @param {HTMLCanvasElement} canvas */
export function cleared(canvas) {
  const ratio = devicePixelRatio || 1;
  const room = canvas.getBoundingClientRect();
  const [width, height] = [Math.round(room.width * ratio), Math.round(room.height * ratio)];
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  const g = canvas.getContext('2d');
  g.clearRect(0, 0, width, height);
  return { g, ratio, height };
}

/** Not known, unless something is drawn over it. */
export function hatched(g, left, top, width, height, ratio) {
  g.save();
  g.beginPath();
  g.rect(left, top, width, height);
  g.clip();
  g.strokeStyle = colour('--grid');
  g.lineWidth = ratio;
  g.beginPath();
  for (let x = left - height; x < left + width; x += 8 * ratio) {
    g.moveTo(x, top + height);
    g.lineTo(x + height, top);
  }
  g.stroke();
  g.restore();
}
