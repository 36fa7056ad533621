import type { PictureHeader } from '../link/protocol';

/** Constrained baseline, level 4: what the server sends at most. */
const USUAL_CODEC = 'avc1.42E028';
const PATIENCE_MS = 2000;

/** Decodes pictures that come as H.264: one in, one out. */
export class Video {
  private decoder: VideoDecoder | undefined;
  private readonly waiting = new Map<number, (frame: VideoFrame | undefined) => void>();

  /** Whether the browser decodes it: WebCodecs are there on https and on this machine alone. */
  static async isSupported(): Promise<boolean> {
    if (!window.isSecureContext || typeof VideoDecoder === 'undefined') return false;
    try {
      return (await VideoDecoder.isConfigSupported({ codec: USUAL_CODEC, optimizeForLatency: true })).supported === true;
    } catch {
      return false;
    }
  }

  /** The picture of a message; undefined where it cannot be decoded. */
  decode(header: PictureHeader, file: ArrayBuffer): Promise<VideoFrame | undefined> {
    const length = new DataView(file).getUint32(0, true);
    try {
      if (length > 0) this.begin(new Uint8Array(file, 4, length));
      if (this.decoder?.state !== 'configured') return Promise.resolve(undefined);
      const chunk = new EncodedVideoChunk({ type: header.isKey ? 'key' : 'delta', timestamp: header.n, data: new Uint8Array(file, 4 + length) });
      this.decoder.decode(chunk);
    } catch {
      this.end();
      return Promise.resolve(undefined);
    }
    return new Promise((resolve) => {
      const patience = window.setTimeout(() => answer(undefined), PATIENCE_MS);
      const answer = (frame: VideoFrame | undefined) => {
        window.clearTimeout(patience);
        this.waiting.delete(header.n);
        resolve(frame);
      };
      this.waiting.set(header.n, answer);
    });
  }

  /** A new stream: another size, or another rate. */
  private begin(config: Uint8Array): void {
    this.end();
    const decoder = new VideoDecoder({
      output: (frame) => {
        const answer = this.waiting.get(frame.timestamp);
        if (answer === undefined) frame.close();
        else answer(frame);
      },
      error: () => this.end(),
    });
    const codec = `avc1.${[1, 2, 3].map((i) => config[i]!.toString(16).padStart(2, '0')).join('')}`;
    decoder.configure({ codec, description: config, optimizeForLatency: true });
    this.decoder = decoder;
  }

  private end(): void {
    if (this.decoder !== undefined && this.decoder.state !== 'closed') this.decoder.close();
    this.decoder = undefined;
    for (const answer of [...this.waiting.values()]) answer(undefined);
  }
}
