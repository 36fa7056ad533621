import { useRef } from 'preact/hooks';
import type { App } from '../app';
import { chartOf, MARGIN, toSvg } from '../measure/chart';
import { toCsv, toGeoJson } from '../measure/export';
import { climbs, groundLength, planArea, planLength, type Station } from '../measure/geometry';
import type { MeasureState, Tool } from '../measure/measuring';
import { useStore } from '../state/store';
import { download } from './actions';
import { Button, Choice, Figure } from './controls';
import { lonLat, metres, place, squareMetres } from './format';
import { Icon } from './icons';

const TOOLS: readonly (readonly [Tool, string])[] = [
  ['off', 'Off'],
  ['point', 'Point'],
  ['line', 'Line'],
  ['area', 'Area'],
];

const HINTS: Record<Tool, string> = {
  off: 'Choose what to measure, then click in the picture or on the map.',
  point: 'Click on the ground to read a place.',
  line: 'Click along a line: distance, height difference and profile.',
  area: 'Click the corners of an area.',
};

export function MeasureTab({ app }: { app: App }) {
  const state = useStore(app.measuring.store, (value) => value);
  const { tool, points, profile, problem } = state;
  return (
    <div class="columns">
      <section class="group" aria-label="Measure">
        <h2>Measure</h2>
        <Choice label="What to measure" value={tool} options={TOOLS} change={(next) => app.measuring.use(next)} />
        {points.length === 0 ? <p class="hint">{HINTS[tool]}</p> : <Results app={app} state={state} />}
        {problem !== undefined && <p class="problem">{problem}</p>}
      </section>
      {profile.length > 1 && (
        <section class="group wide" aria-label="Elevation profile">
          <h2>Elevation profile</h2>
          <Profile profile={profile} marked={state.marked} mark={(station) => app.measuring.mark(station)} />
        </section>
      )}
    </div>
  );
}

function Results({ app, state }: { app: App; state: MeasureState }) {
  const { tool, points, profile } = state;
  const world = useStore(app.viewer.store, (value) => value.world);
  const [first, last] = [points[0]!, points[points.length - 1]!];
  const { up, down } = climbs(profile);
  const geographic = lonLat(last, world);
  const title = tool === 'area' ? 'Outline' : 'Profile';
  return (
    <>
      <dl class="figures">
        {tool === 'point' && <Figure name="Place">{place(last[0], last[1], world)}</Figure>}
        {tool === 'point' && geographic !== undefined && <Figure name="Position">{geographic}</Figure>}
        {tool === 'point' && <Figure name="Height">{last[2].toFixed(1)} m</Figure>}
        {tool !== 'point' && <Figure name="Distance">{metres(planLength(points))}</Figure>}
        {tool === 'line' && <Figure name="Over the ground">{profile.length > 1 ? metres(groundLength(profile)) : '…'}</Figure>}
        {tool === 'line' && <Figure name="Height difference">{(last[2] - first[2]).toFixed(1)} m</Figure>}
        {tool === 'line' && profile.length > 1 && <Figure name="Up / down">{`${up.toFixed(0)} / ${down.toFixed(0)} m`}</Figure>}
        {tool === 'area' && <Figure name="Area">{points.length > 2 ? squareMetres(planArea(points)) : 'three corners at least'}</Figure>}
      </dl>
      <div class="row wrap">
        <Button label="Take the last point back" click={() => app.measuring.removeLast()}>
          <Icon name="undo" />
        </Button>
        {world !== undefined && (
          <>
            <Button title="Copy as GeoJSON" click={() => void app.actions.copy(toGeoJson(tool, points, profile, world), 'GeoJSON copied')}>
              Copy
            </Button>
            <Button title="Save as GeoJSON" click={() => download('measure.geojson', toGeoJson(tool, points, profile, world), 'application/geo+json')}>
              GeoJSON
            </Button>
          </>
        )}
        {profile.length > 1 && (
          <>
            <Button title="Save the profile as a table" click={() => download('profile.csv', toCsv(profile), 'text/csv')}>
              CSV
            </Button>
            <Button title="Save the profile as a drawing" click={() => download('profile.svg', toSvg(profile, title), 'image/svg+xml')}>
              SVG
            </Button>
          </>
        )}
      </div>
    </>
  );
}

interface ProfileProps {
  profile: readonly Station[];
  marked: number | undefined;
  mark(station: number | undefined): void;
}

function Profile({ profile, marked, mark }: ProfileProps) {
  const drawing = useRef<SVGSVGElement>(null);
  // As wide as it is shown, so that its text is as large as other text.
  const isNarrow = window.innerWidth <= 640;
  const chart = chartOf(profile, isNarrow ? 366 : 560, isNarrow ? 140 : 150);
  if (chart === undefined) return <p class="hint">There is no ground along this line.</p>;
  const last = profile[profile.length - 1]!;
  const at = marked === undefined ? undefined : profile[marked];
  const nearest = (event: PointerEvent) => {
    const box = drawing.current!.getBoundingClientRect();
    const x = ((event.clientX - box.left) / box.width) * chart.width;
    const share = (x - MARGIN.left) / (chart.width - MARGIN.left - MARGIN.right);
    mark(Math.round(Math.min(1, Math.max(0, share)) * (profile.length - 1)));
  };
  const key = (event: KeyboardEvent) => {
    const way = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (way === undefined) return;
    event.preventDefault();
    event.stopPropagation();
    mark(Math.min(profile.length - 1, Math.max(0, (marked ?? 0) + way * (event.shiftKey ? 20 : 4))));
  };
  const said = at === undefined ? metres(last.along) : `${metres(at.along)}: ${at.height === null ? 'no ground' : `${at.height.toFixed(1)} m`}`;
  return (
    <div class="profile">
      <svg
        ref={drawing}
        viewBox={`0 0 ${chart.width} ${chart.height}`}
        role="slider"
        tabIndex={0}
        aria-label="Place along the line"
        aria-valuemin={0}
        aria-valuemax={Math.round(last.along)}
        aria-valuenow={Math.round(at?.along ?? 0)}
        aria-valuetext={said}
        onPointerMove={nearest}
        onPointerLeave={() => mark(undefined)}
        onKeyDown={key}
      >
        {chart.yTicks.map(({ at: y, label }) => (
          <g key={label}>
            <path class="grid" d={`M${MARGIN.left},${y}H${chart.width - MARGIN.right}`} />
            <text x={MARGIN.left - 6} y={y + 4} text-anchor="end">
              {label}
            </text>
          </g>
        ))}
        {chart.xTicks.map(({ at: x, label }) => (
          <text key={label} x={x} y={chart.height - 5} text-anchor="middle">
            {label}
          </text>
        ))}
        {chart.areas.map((d) => (
          <path key={d} class="ground" d={d} />
        ))}
        {chart.lines.map((d) => (
          <path key={d} class="line" d={d} />
        ))}
        {at !== undefined && at.height !== null && (
          <>
            <path class="mark" d={`M${chart.xOf(at.along)},${MARGIN.top}V${chart.height - MARGIN.bottom}`} />
            <circle class="mark" cx={chart.xOf(at.along)} cy={chart.yOf(at.height)} r="3.5" />
          </>
        )}
      </svg>
      <p class="said" aria-hidden="true">
        {said}
      </p>
    </div>
  );
}
