import { fromServer, toJson, toKml } from '../paths/file';
import type { PathEditor } from '../paths/editor';
import type { Settings, Stereo } from '../link/protocol';
import type { Pose } from '../math/pose';
import type { Viewer } from '../state/viewer';
import type { Motion } from '../view/motion';
import { toHash } from '../state/address';
import { kindOfSun } from '../state/sun';

/** Hands a file to the user. */
export function download(name: string, content: string | Blob, type = 'application/octet-stream'): void {
  const blob = typeof content === 'string' ? new Blob([content], { type }) : content;
  const link = document.createElement('a');
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  window.setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}

/** What went wrong, for people. */
export const sentence = (error: unknown): string => (error instanceof Error ? error.message : String(error));

/** The flags of two eyes, as a command has them. */
function stereoFlags(settings: Settings): string {
  if (settings.stereo == null || settings.stereo === 'off') return '';
  const metres = (flag: string, value: number | null) => (value === null ? '' : ` --${flag} ${value}`);
  return ` --stereo ${settings.stereo}${metres('convergence', settings.convergence)}${metres('eye-separation', settings.eye_separation)}`;
}

const exaggerationFlag = ({ exaggeration }: Settings): string => (exaggeration == null || exaggeration === 1 ? '' : ` --exaggeration ${exaggeration}`);

/** The flags of light and air. */
function lightFlags({ sun, shadows, haze }: Settings): string {
  const isLit = kindOfSun(sun) !== 'off';
  return `${isLit ? ` --sun ${sun!.replaceAll(' ', sun!.includes(',') ? '' : 'T')}${shadows === true ? ' --shadows' : ''}` : ''}${haze ? ` --haze ${haze}` : ''}`;
}

/** What buttons and keys do. */
export class Actions {
  constructor(
    private readonly viewer: Viewer,
    private readonly motion: Motion,
    private readonly path: PathEditor,
  ) {}

  /** The place in the middle of the picture, which turning and tilting goes about. */
  async middle() {
    return (await this.viewer.pick(this.viewer.middle))?.place;
  }

  async turn(heading: number, pitch: number): Promise<void> {
    this.motion.turnBy(await this.middle(), heading, pitch);
  }

  async zoom(factor: number): Promise<void> {
    const place = (await this.middle()) ?? this.viewer.ahead(this.viewer.middle);
    if (place !== undefined) this.motion.zoomBy(place, factor);
  }

  /** One eye or two, whose pictures meet on the ground in the middle. */
  async setStereo(stereo: Stereo): Promise<void> {
    const hit = stereo === 'off' ? null : await this.viewer.pick(this.viewer.middle);
    this.viewer.changeSettings(hit === null ? { stereo } : { stereo, convergence: Number(hit.distance.toPrecision(3)), eye_separation: null });
  }

  async northUp(): Promise<void> {
    this.motion.northUp(await this.middle());
  }

  async goTo(pose: Pose, seconds?: number): Promise<void> {
    await this.motion.goTo(pose, seconds);
  }

  reset(): void {
    const start = this.viewer.store.get().world?.start;
    if (start !== undefined) void this.motion.goTo(start);
  }

  stop(): void {
    this.motion.stop();
    this.motion.letAllGo();
  }

  async copyLink(): Promise<void> {
    const pose = this.viewer.pose;
    if (pose === undefined) return;
    const address = new URL(window.location.href);
    address.hash = toHash(pose);
    await this.copy(address.href, 'Link copied');
  }

  /** The command that draws the view of now, as a shell takes it. */
  command(): string {
    const { world, shown, settings } = this.viewer.store.get();
    const pose = this.viewer.pose;
    if (pose === undefined || world === undefined) return '';
    const width = shown === undefined ? 0 : this.viewer.isPair ? Math.floor(shown.width / 2) : shown.width;
    const size = shown === undefined ? '' : ` --size ${width}x${shown.height}`;
    const flags = settings === undefined ? '' : `${exaggerationFlag(settings)}${lightFlags(settings)}${stereoFlags(settings)}`;
    const quoted = /^[\w./:-]+$/.test(world.name) ? world.name : `'${world.name.replace(/'/g, `'\\''`)}'`;
    return `terravision still ${quoted} --eye=${pose.x},${pose.y},${pose.z} --heading=${pose.heading} --pitch=${pose.pitch} --roll=${pose.roll} --vfov=${pose.vfov}${size}${flags} -o view.png`;
  }

  async copyCommand(): Promise<void> {
    await this.copy(this.command(), 'Command copied');
  }

  /** The picture of now at the best quality. */
  async savePicture(): Promise<void> {
    const { shown } = this.viewer.store.get();
    const pose = this.viewer.pose;
    if (pose === undefined || shown === undefined) return;
    try {
      download('terravision.png', await this.viewer.api.still(pose, shown.width, shown.height, { hasStereo: true }));
    } catch (error) {
      this.viewer.note('warning', sentence(error));
    }
  }

  /** The path as `terravision fly` reads it. */
  pathJson(): string {
    return toJson(this.path.store.get(), this.viewer.store.get().world?.epsg ?? null);
  }

  savePath(): void {
    download('path.json', this.pathJson(), 'application/json');
  }

  /** The path as a tour of Google Earth. */
  saveKml(): void {
    const { world } = this.viewer.store.get();
    const spline = this.path.spline;
    if (world === undefined || spline === undefined) return;
    const keyframes = this.path.store.get().keyframes.map((key) => ({ ...key, ...spline.pose(key.t) }));
    const kml = toKml(keyframes, world.name, world.epsg);
    if (kml === undefined) this.viewer.note('warning', 'KML has longitudes and latitudes, which the page does not know of this world: save JSON');
    else download('path.kml', kml, 'application/vnd.google-earth.kml+xml');
  }

  async loadPath(file: File): Promise<void> {
    try {
      this.path.load(fromServer(await this.viewer.api.convertPath(file.name, file), this.viewer.pose?.vfov ?? 60));
    } catch (error) {
      this.path.refuse(sentence(error));
    }
  }

  /** Without a secure context there is no clipboard: then the text is shown, selected. */
  async copy(text: string, done: string): Promise<void> {
    try {
      await navigator.clipboard.writeText(text);
      this.viewer.note('info', done);
    } catch {
      window.dispatchEvent(new CustomEvent('terravision-copy', { detail: text }));
    }
  }
}
