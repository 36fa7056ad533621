import { toJson, fromJson } from '../paths/file';
import type { PathEditor } from '../paths/editor';
import type { Pose } from '../math/pose';
import type { Viewer } from '../state/viewer';
import type { Motion } from '../view/motion';
import { toHash } from '../state/address';

/** Hands a file to the user. */
export function download(name: string, content: string | Blob, type = 'application/octet-stream'): void {
  const blob = typeof content === 'string' ? new Blob([content], { type }) : content;
  const link = document.createElement('a');
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  window.setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
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
    const { width, height } = this.viewer.picture!.size;
    return (await this.viewer.pick({ u: width / 2, v: height / 2 }))?.place;
  }

  async turn(heading: number, pitch: number): Promise<void> {
    this.motion.turnBy(await this.middle(), heading, pitch);
  }

  async zoom(factor: number): Promise<void> {
    const { width, height } = this.viewer.picture!.size;
    const place = (await this.middle()) ?? this.viewer.ahead({ u: width / 2, v: height / 2 });
    if (place !== undefined) this.motion.zoomBy(place, factor);
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
    const size = shown === undefined ? '' : ` --size ${shown.width}x${shown.height}`;
    const exaggeration = settings?.exaggeration == null || settings.exaggeration === 1 ? '' : ` --exaggeration ${settings.exaggeration}`;
    const quoted = /^[\w./:-]+$/.test(world.name) ? world.name : `'${world.name.replace(/'/g, `'\\''`)}'`;
    return `terravision still ${quoted} --eye=${pose.x},${pose.y},${pose.z} --heading=${pose.heading} --pitch=${pose.pitch} --roll=${pose.roll} --vfov=${pose.vfov}${size}${exaggeration} -o view.png`;
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
      download('terravision.png', await this.viewer.api.still(pose, shown.width, shown.height));
    } catch (error) {
      this.viewer.note('warning', error instanceof Error ? error.message : String(error));
    }
  }

  savePath(): void {
    const { world } = this.viewer.store.get();
    download('path.json', toJson(this.path.store.get().keyframes, world?.epsg ?? null), 'application/json');
  }

  async loadPath(file: File): Promise<void> {
    const { world } = this.viewer.store.get();
    try {
      this.path.load(fromJson(await file.text(), this.viewer.pose?.vfov ?? 60, world?.epsg ?? null));
    } catch (error) {
      this.viewer.note('warning', `${file.name}: ${error instanceof Error ? error.message : String(error)}`);
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
