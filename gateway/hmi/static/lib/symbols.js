// Signs as SVG paths on a square of 100 by 100. Shapes tell what colours tell, so that neither is needed alone. Pure.

/** @type {Record<string, string>} */
export const PATHS = {
  octagon: 'M30 3H70L97 30V70L70 97H30L3 70V30Z',
  stop: 'M30 3H70L97 30V70L70 97H30L3 70V30ZM19 41V59H81V41Z',
  up: 'M50 4L92 48H67V96H33V48H8Z',
  down: 'M50 96L8 52H33V4H67V52H92Z',
  left: 'M4 50L48 8V33H96V67H48V92Z',
  right: 'M96 50L52 92V67H4V33H52V8Z',
  slow: 'M50 4L88 42H12ZM29 50H71V66H29ZM29 73H71V82H29ZM29 89H71V96H29Z',
  pause: 'M18 8H42V92H18ZM58 8H82V92H58Z',
  tick: 'M8 54L24 38L42 57L78 17L94 33L42 89Z',
};
