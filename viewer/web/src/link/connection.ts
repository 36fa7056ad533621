import { readPicture, type ClientMessage, type PictureHeader, type ServerMessage } from './protocol';

export interface Events {
  /** The socket is open; what is said first. */
  hello(): ClientMessage;
  message(message: ServerMessage): void;
  picture(header: PictureHeader, file: ArrayBuffer): void;
  /** The link is gone; it is tried again in so many seconds, or never. */
  lost(retryInS: number | undefined): void;
}

/** Reasons to leave that a new connection does not mend. */
const FINAL = new Set(['wrong-token', 'wrong-protocol']);
/** Seconds without any message after which the link counts as lost: the server sends its figures once a second. */
const SILENCE_S = 8;

/** The WebSocket to the server: comes back by itself. */
export class Connection {
  private socket: WebSocket | undefined;
  private attempts = 0;
  private retry: number | undefined;
  private watchdog: number | undefined;
  private lastHeard = 0;
  private isFinal = false;

  constructor(
    private readonly events: Events,
    private readonly address: string,
  ) {}

  start(): void {
    this.isFinal = false;
    window.clearTimeout(this.retry);
    this.open();
    this.watchdog ??= window.setInterval(() => this.watch(), 1000);
  }

  get isOpen(): boolean {
    return this.socket !== undefined && this.socket.readyState === this.socket.OPEN;
  }

  /** Whether the message went out. */
  send(message: ClientMessage): boolean {
    if (!this.isOpen) return false;
    this.socket!.send(JSON.stringify(message));
    return true;
  }

  private open(): void {
    const socket = new WebSocket(this.address);
    socket.binaryType = 'arraybuffer';
    this.socket = socket;
    this.lastHeard = performance.now();
    socket.onopen = () => {
      this.send(this.events.hello());
    };
    socket.onmessage = (event) => {
      if (this.socket === socket) this.receive(event.data as string | ArrayBuffer);
    };
    socket.onclose = () => {
      if (this.socket === socket) this.closed();
    };
  }

  private receive(data: string | ArrayBuffer): void {
    this.lastHeard = performance.now();
    if (typeof data !== 'string') {
      const picture = readPicture(data);
      if (picture !== undefined) this.events.picture(picture.header, picture.file);
      return;
    }
    const message = JSON.parse(data) as ServerMessage;
    if (message.type === 'welcome') this.attempts = 0;
    if (message.type === 'bye') this.isFinal = FINAL.has(message.code);
    this.events.message(message);
  }

  private closed(): void {
    this.socket = undefined;
    if (this.isFinal) {
      this.events.lost(undefined);
      return;
    }
    // Quick at first, for a server that is started again; then less often, not to press one that is busy.
    const seconds = Math.min(5, 0.25 * 2 ** this.attempts);
    this.attempts++;
    this.events.lost(seconds);
    this.retry = window.setTimeout(() => this.open(), seconds * 1000);
  }

  private watch(): void {
    const socket = this.socket;
    if (socket === undefined || performance.now() - this.lastHeard < SILENCE_S * 1000) return;
    // A link that was cut silently: do not wait for the system to notice.
    socket.onclose = null;
    socket.onmessage = null;
    socket.close();
    this.closed();
  }
}

