/** Icons drawn here, so that nothing is fetched from elsewhere. */
const PATHS = {
  plus: 'M12 5v14M5 12h14',
  minus: 'M5 12h14',
  left: 'M4 12a8 8 0 1 0 3-6.2M4 4v4h4',
  right: 'M20 12a8 8 0 1 1-3-6.2M20 4v4h-4',
  up: 'M4 18h16M12 14V4M8 8l4-4 4 4',
  down: 'M4 6h16M12 10v10M8 16l4 4 4-4',
  home: 'M4 11l8-7 8 7M6 10v10h12V10',
  play: 'M8 5l11 7-11 7z',
  pause: 'M8 5v14M16 5v14',
  record: 'M12 7a5 5 0 1 0 0 10 5 5 0 0 0 0-10z',
  link: 'M10 14a4 4 0 0 0 6 0l3-3a4 4 0 0 0-6-6l-1 1M14 10a4 4 0 0 0-6 0l-3 3a4 4 0 0 0 6 6l1-1',
  help: 'M9 9a3 3 0 1 1 4.5 2.6c-1 .6-1.5 1.2-1.5 2.4M12 18v.01',
  fold: 'M6 9l6 6 6-6',
  unfold: 'M6 15l6-6 6 6',
  close: 'M6 6l12 12M18 6L6 18',
  remove: 'M6 7h12M9 7V4h6v3M8 7l1 13h6l1-13',
  save: 'M12 4v11M7 11l5 5 5-5M5 20h14',
  load: 'M12 16V5M7 9l5-5 5 5M5 20h14',
  undo: 'M8 6L4 10l4 4M4 10h10a5 5 0 0 1 0 10h-3',
  target: 'M12 5v4M12 15v4M5 12h4M15 12h4M12 12v.01',
  command: 'M5 7l5 5-5 5M12 17h7',
  grid: 'M4 4h16v16H4zM12 4v16M4 12h16M16 12v8M12 16h8',
  rest: 'M4 16c4 0 4-8 8-8s4 8 8 8',
  film: 'M4 5h16v14H4zM8 5v14M16 5v14M4 12h4M16 12h4',
} as const;

export type IconName = keyof typeof PATHS;

export function Icon({ name }: { name: IconName }) {
  return (
    <svg class="icon" viewBox="0 0 24 24" aria-hidden="true">
      <path d={PATHS[name]} />
    </svg>
  );
}
