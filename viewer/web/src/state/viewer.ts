import { Connection } from '../link/connection';
import { Api, tokenOf } from '../link/http';
import { PROTOCOL, type ClientMessage, type Picked, type PictureHeader, type ServerMessage, type Settings, type StateMessage } from '../link/protocol';
import { aboveGround, nearWorld } from '../math/navigate';
import { axesOf, eyeOf, isPose, rayThrough, samePose, tidy, type Point, type Pose, type Size } from '../math/pose';
import { add, dot, scale, sub, type Vec3 } from '../math/vector';
import { eyesOf } from '../math/stereo';
import type { Pair, Picture } from '../view/picture';
import { Video } from '../view/video';
import { Latency } from './latency';
import { EMPTY, isPilot, type State } from './state';
import { Store } from './store';

const PICK_PATIENCE_MS = 1500;
/** Distance between the eyes, where no other is asked for, as a share of the distance at which their pictures meet. */
const USUAL_SEPARATION = 1 / 30;
const POSE_EVERY_MS = 8;
const GROUND_EVERY_MS = 200;
const PANEL_EVERY_MS = 100;

/** A place that a point of the picture shows. */
export interface Hit {
  /** Height as drawn: with exaggeration, as heights of the camera are. */
  place: Vec3;
  /** The ground itself. */
  point: Vec3;
  distance: number;
}

/**
 * The page's end of the link: the camera of now, the picture that is shown, what the server said. The camera is this page's
 * while it is the pilot, and that of the picture while another one is.
 */
export class Viewer {
  readonly store = new Store<State>(EMPTY);
  readonly latency = new Latency();
  readonly api: Api;
  /** The camera of now. */
  pose: Pose | undefined;
  picture: Picture | undefined;

  private readonly connection: Connection;
  private token: string;
  private lastId = 0;
  private lastSent: Pose | undefined;
  private sentAt = 0;
  private poseTimer: number | undefined;
  private readonly picks = new Map<number, (hit: Hit | null) => void>();
  private nextPick = 1;
  private groundAskedAt = 0;
  private panelTimer: number | undefined;
  private notes = 0;
  private readonly onPicture = new Set<(header: PictureHeader) => void>();
  private readonly onMove = new Set<() => void>();
  private wanted: Pose | undefined;
  private hasMap = false;
  private hasVideo = false;

  constructor(
    location: Location,
    private readonly reload: () => void,
  ) {
    this.token = tokenOf(location.search);
    this.api = new Api(this.token);
    const scheme = location.protocol === 'https:' ? 'wss' : 'ws';
    this.connection = new Connection(
      {
        hello: () => this.hello(new URLSearchParams(location.search).has('watch')),
        message: (message) => this.receive(message),
        picture: (header, file) => void this.show(header, file),
        lost: (retry) => this.lost(retry),
      },
      `${scheme}://${location.host}/api/socket`,
    );
  }

  /** Begins, with a camera that the page's address asks for. */
  start(picture: Picture, wanted: Pose | undefined): void {
    this.picture = picture;
    this.wanted = wanted;
    if (typeof WebSocket === 'undefined') {
      const text = 'This browser has no WebSocket, over which pictures come. Open the page in another one.';
      this.store.set({ link: { kind: 'refused', code: 'no-websocket', text } });
      return;
    }
    void Video.isSupported().then((isSupported) => {
      this.hasVideo = isSupported;
      this.connection.start();
    });
  }

  /** Tries once more, with a token that the user typed. */
  useToken(token: string): void {
    this.token = token;
    this.api.useToken(token);
    this.store.set({ link: { kind: 'connecting' } });
    this.connection.start();
  }

  get isPilot(): boolean {
    return isPilot(this.store.get());
  }

  /** How much taller than it is the ground is drawn. */
  get exaggeration(): number {
    return this.store.get().settings?.exaggeration ?? 1;
  }

  /** Height of the ground under the camera, as drawn; the world's middle height where it is not known yet. */
  get ground(): number {
    const { groundBelow, world } = this.store.get();
    if (groundBelow !== undefined) return groundBelow;
    return world?.heights ? ((world.heights[0] + world.heights[1]) / 2) * this.exaggeration : 0;
  }

  /** Height of the eye above ground, at least a metre. */
  get clearance(): number {
    return this.pose === undefined ? 1 : Math.max(1, this.pose.z - this.ground);
  }

  /** Moves the camera; false when another one is the pilot. */
  setPose(pose: Pose, inputAt = performance.now()): boolean {
    if (!this.isPilot || this.store.get().isReadOnly) return false;
    const { groundBelow, world } = this.store.get();
    const next = tidy(aboveGround(world === undefined ? pose : nearWorld(pose, world.bounds), groundBelow));
    // What is not a number would be refused, and everything that follows from it.
    if (!isPose(next)) return false;
    if (this.pose !== undefined && samePose(next, this.pose)) return true;
    this.pose = next;
    this.sendSoon(inputAt);
    this.moved();
    return true;
  }

  changeSettings(settings: Partial<Settings>): void {
    this.connection.send({ type: 'settings', ...settings });
  }

  takeOver(): void {
    this.connection.send({ type: 'take-over' });
  }

  /** Somebody looks at a map: the server tells what it shows, until the function that is returned is called. */
  showMap(): () => void {
    this.hasMap = true;
    this.connection.send({ type: 'map', wanted: true });
    return () => {
      this.hasMap = false;
      this.connection.send({ type: 'map', wanted: false });
    };
  }

  resized(): void {
    const { width, height } = this.picture!.size;
    this.connection.send({ type: 'size', size: [width, height], dpr: window.devicePixelRatio });
    this.moved();
  }

  /** The eyes that are shown side by side; undefined for a single picture. */
  get pair(): Pair {
    const { settings } = this.store.get();
    if (settings?.stereo !== 'side-by-side' || settings.convergence === null) return undefined;
    return eyesOf(settings.eye_separation ?? settings.convergence * USUAL_SEPARATION, settings.convergence);
  }

  get isPair(): boolean {
    return this.pair !== undefined;
  }

  /** Size of what one eye sees: the view, or a half of it. */
  get eye(): Size {
    const { width, height } = this.picture!.size;
    return this.isPair ? { width: width / 2, height } : { width, height };
  }

  /** A point of the view as the eye sees it in whose half another point lies. */
  inEye(point: Point, of: Point = point): Point {
    const { width } = this.eye;
    return this.isPair ? { u: point.u - (of.u >= width ? width : 0), v: point.v } : point;
  }

  /** The middle of what the (left) eye sees. */
  get middle(): Point {
    const { width, height } = this.eye;
    return { u: width / 2, v: height / 2 };
  }

  /** What is under a point of the view; null for sky, and when the server does not answer soon. */
  pick(point: Point): Promise<Hit | null> {
    const shown = this.picture?.shown;
    const place = this.picture?.under(point);
    const id = this.nextPick++;
    const isSent = shown !== undefined && place !== undefined && this.connection.send({ type: 'pick', id, ...place, n: shown.n });
    if (!isSent) return Promise.resolve(null);
    return new Promise((resolve) => {
      const answer = (hit: Hit | null) => {
        window.clearTimeout(patience);
        this.picks.delete(id);
        resolve(hit === null ? null : this.betweenEyes(hit, shown, place));
      };
      const patience = window.setTimeout(() => answer(null), PICK_PATIENCE_MS);
      this.picks.set(id, answer);
    });
  }

  /**
   * Of two eyes the place that a camera between them would show there: hands then hold what is under them, and not what is
   * beside it by half of the disparity.
   */
  private betweenEyes(hit: Hit, shown: PictureHeader, at: Point): Hit {
    const stereo = this.store.get().settings?.stereo ?? 'off';
    if (stereo === 'off') return hit;
    const u = stereo === 'side-by-side' ? (at.u * 2) % 1 : at.u;
    const ray = rayThrough(shown.pose, this.eye, { u: u * this.eye.width, v: at.v * this.eye.height });
    const depth = dot(sub(hit.place, eyeOf(shown.pose)), axesOf(shown.pose).forward);
    return { ...hit, place: add(eyeOf(shown.pose), scale(ray, depth)) };
  }

  /** The longer side of the world, metres. */
  get worldSide(): number {
    const bounds = this.store.get().world?.bounds;
    return bounds === undefined ? 1e4 : Math.max(bounds[1][0] - bounds[0][0], bounds[1][1] - bounds[0][1]);
  }

  /** A place in the direction of a point of the view, as far away as the ground below is, or somewhat farther. */
  ahead(point: Point): Vec3 | undefined {
    const pose = this.pose;
    if (pose === undefined) return undefined;
    const ray = rayThrough(pose, this.eye, this.inEye(point));
    return add(eyeOf(pose), scale(ray, 3 * this.clearance));
  }

  /** Calls a function for every picture that is shown from now on. */
  watchPictures(listener: (header: PictureHeader) => void): () => void {
    this.onPicture.add(listener);
    return () => this.onPicture.delete(listener);
  }

  /** Calls a function whenever the camera or the picture changes. */
  watchMoves(listener: () => void): () => void {
    this.onMove.add(listener);
    return () => this.onMove.delete(listener);
  }

  /** Whether the shown picture is the final one of the camera of now. */
  get isSettled(): boolean {
    const shown = this.picture?.shown;
    const { link, flight } = this.store.get();
    if (shown === undefined || link.kind !== 'open' || flight !== 'flying') return false;
    const isOfNow = !this.isPilot || this.lastSent === undefined || (shown.poseId === this.lastId && this.poseTimer === undefined);
    return isOfNow && shown.isExact;
  }

  note(level: 'info' | 'warning', text: string): void {
    const id = ++this.notes;
    this.store.set({ notes: [...this.store.get().notes.slice(-2), { id, level, text }] });
    window.setTimeout(() => this.dismiss(id), level === 'info' ? 5000 : 9000);
  }

  dismiss(id: number): void {
    this.store.set({ notes: this.store.get().notes.filter((note) => note.id !== id) });
  }

  private hello(watch: boolean): ClientMessage {
    const { width, height } = this.picture!.size;
    return {
      type: 'hello',
      protocol: PROTOCOL,
      ...(this.token === '' ? {} : { token: this.token }),
      size: [width, height],
      dpr: window.devicePixelRatio,
      ...(watch ? { watch } : {}),
      ...(this.hasVideo ? { h264: true } : {}),
    };
  }

  /** Sends the camera of now, or of a moment later: displays and mice are faster than what the server takes. */
  private sendSoon(inputAt: number): void {
    if (this.poseTimer !== undefined) return;
    const wait = this.sentAt + POSE_EVERY_MS - performance.now();
    if (wait <= 0) {
      this.sendPose(inputAt);
      return;
    }
    this.poseTimer = window.setTimeout(() => {
      this.poseTimer = undefined;
      if (this.isPilot) this.sendPose(inputAt);
    }, wait);
  }

  /** Sends the camera of now; without an input its picture is no answer whose time counts. */
  private sendPose(inputAt?: number): void {
    const pose = this.pose!;
    const id = this.lastId + 1;
    if (!this.connection.send({ type: 'pose', id, ...pose })) return;
    this.lastId = id;
    this.lastSent = pose;
    this.sentAt = performance.now();
    if (inputAt !== undefined) this.latency.poseSent(id, inputAt);
  }

  private receive(message: ServerMessage): void {
    switch (message.type) {
      case 'welcome':
        return this.welcomed(message);
      case 'state': {
        const { type: _, ...state } = message;
        return this.takeState(state, false);
      }
      case 'figures':
        this.store.set({ figures: message, latency: this.latency.summary() });
        return;
      case 'films':
        this.store.set({ films: message });
        return;
      case 'map':
        this.store.set({ map: message });
        return;
      case 'picked':
        return this.picked(message);
      case 'notice':
        this.note(message.level, message.text);
        return;
      case 'error':
        // Who is not the pilot has heard so; a pick needs a picture, and gets none before the first one.
        if (message.code !== 'not-pilot' && message.code !== 'no-picture') this.note('warning', message.text);
        return;
      case 'bye':
        return this.refused(message.code, message.text);
      case 'probe':
        this.connection.send({ type: 'probed', time_ms: message.time_ms });
        return;
      case 'pong':
        return;
    }
  }

  private welcomed(message: Extract<ServerMessage, { type: 'welcome' }>): void {
    const before = this.store.get().version;
    if (before !== '' && before !== message.version) {
      this.reload();
      return;
    }
    this.store.set({
      link: { kind: 'open' },
      version: message.version,
      world: message.world,
      limits: message.limits,
      isReadOnly: message.is_read_only,
      you: message.you,
    });
    this.lastId = 0;
    this.lastSent = undefined;
    this.latency.clear();
    this.pose ??= message.world.start;
    if (this.wanted !== undefined) {
      this.pose = nearWorld(this.wanted, message.world.bounds);
      this.wanted = undefined;
    }
    if (this.hasMap) this.connection.send({ type: 'map', wanted: true });
    this.takeState(message, true);
    this.moved();
  }

  private takeState(state: StateMessage, isWelcome: boolean): void {
    const wasPilot = this.isPilot;
    const { flight, reason, settings, pilot, people } = state;
    // A flight that is started again is told as that, and does not count as a slow answer.
    if (flight !== 'flying') this.latency.clear();
    this.store.set({ flight, flightReason: reason, settings, pilot, people });
    if (!this.isPilot || (wasPilot && !isWelcome)) return;
    // After a reconnection the camera is where this page has it; one that takes over goes on where the other one was.
    if (!isWelcome) this.pose = this.picture?.shown?.pose ?? this.pose;
    if (this.pose !== undefined) this.sendPose();
    this.moved();
  }

  private refused(code: string, text: string): void {
    if (code === 'wrong-protocol') this.reload();
    if (code === 'wrong-token' || code === 'wrong-protocol') this.store.set({ link: { kind: 'refused', code, text } });
    else if (code !== 'ending') this.note('warning', text);
  }

  private lost(retryInS: number | undefined): void {
    for (const answer of [...this.picks.values()]) answer(null);
    this.store.set({ figures: undefined, you: undefined });
    if (retryInS !== undefined) this.store.set({ link: { kind: 'lost' } });
  }

  private async show(header: PictureHeader, file: ArrayBuffer): Promise<void> {
    const begun = performance.now();
    const isShown = await this.picture!.show(header, file, this.pair);
    const failed = !isShown && header.kind === 'h264' ? { failed: true } : {};
    this.connection.send({ type: 'ack', n: header.n, ms: Math.round(performance.now() - begun), ...failed });
    if (!isShown) return;
    this.latency.pictureShown(header, performance.now());
    const isMine = this.isPilot && header.poseId !== 0;
    // Another one's camera; or this one's, where the flight lifted it out of the ground.
    const isOfNow = isMine && header.poseId === this.lastId && this.poseTimer === undefined;
    if (!this.isPilot || (isOfNow && !samePose(header.pose, this.pose!))) this.pose = header.pose;
    this.store.set({ shown: header });
    this.moved();
    for (const listener of [...this.onPicture]) listener(header);
  }

  private picked(message: Picked): void {
    const answer = this.picks.get(message.id);
    const point = message.point;
    if (point === null) return answer?.(null);
    const place: Vec3 = [point[0], point[1], point[2] * this.exaggeration];
    answer?.({ place, point, distance: message.distance_m ?? 0 });
  }

  /** What follows from a camera that has moved, or a picture that has come. */
  private moved(): void {
    const pose = this.pose;
    if (pose === undefined) return;
    this.picture?.place(pose, Math.min(this.ground, pose.z - 1));
    for (const listener of [...this.onMove]) listener();
    this.panelTimer ??= window.setTimeout(() => {
      this.panelTimer = undefined;
      this.store.set({ pose: this.pose });
      void this.askGround();
    }, PANEL_EVERY_MS);
  }

  private async askGround(): Promise<void> {
    const pose = this.pose;
    const now = performance.now();
    if (pose === undefined || now - this.groundAskedAt < GROUND_EVERY_MS) return;
    this.groundAskedAt = now;
    const heights = await this.api.heights([[pose.x, pose.y]]).catch(() => undefined);
    if (heights === undefined) return;
    const height = heights[0];
    this.store.set({
      groundBelow: typeof height === 'number' ? height * this.exaggeration : undefined,
      isOverWorld: typeof height === 'number',
    });
    // Where the camera has gone on meanwhile.
    if (this.pose !== undefined && (this.pose.x !== pose.x || this.pose.y !== pose.y)) this.moved();
  }
}
