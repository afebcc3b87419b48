/** The REST door, as docs/api.md describes it. Works when the WebSocket does not. */

import { token } from "./token";

const TIMEOUT_MS = 1500;

/** The daemon answered, and the answer is no. */
export class Refused extends Error {
  constructor(
    readonly status: number,
    reason: string,
  ) {
    super(reason);
  }

  /** Whether another token would help. */
  get needsToken(): boolean {
    return this.status === 401 || this.status === 403;
  }
}

/** The answer's JSON; Refused when the daemon says no, any other error when it cannot be reached. */
export async function rest<T>(method: string, path: string): Promise<T> {
  const secret = token();
  const response = await fetch(path, {
    method,
    headers: secret ? { Authorization: `Bearer ${secret}` } : {},
    signal: AbortSignal.timeout(TIMEOUT_MS),
    cache: "no-store",
  });
  const body = (await response.json().catch(() => null)) as (T & { error?: { reason?: string } }) | null;
  if (!response.ok || body === null) {
    throw new Refused(response.status, body?.error?.reason ?? `${method} ${path}: ${response.statusText}`);
  }
  return body;
}

/** The path of something that a robot has. */
export function ofRobot(name: string, what: string): string {
  return `api/robots/${encodeURIComponent(name)}/${what}`;
}
