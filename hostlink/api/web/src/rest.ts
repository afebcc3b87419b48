/** The REST API, as docs/api.md describes it. Works when the WebSocket does not. */

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
}

/** The answer's JSON; Refused when the daemon says no, any other error when it cannot be reached. */
export async function rest<T>(method: string, path: string, body?: object): Promise<T> {
  const secret = token();
  const response = await fetch(path, {
    method,
    body: body && JSON.stringify(body),
    headers: secret ? { Authorization: `Bearer ${secret}` } : {},
    signal: AbortSignal.timeout(TIMEOUT_MS),
    cache: "no-store",
  });
  const answer = (await response.json().catch(() => null)) as (T & { error?: { reason?: string } }) | null;
  if (!response.ok || answer === null) {
    throw new Refused(response.status, answer?.error?.reason ?? `${method} ${path}: ${response.statusText}`);
  }
  return answer;
}

/** The path of something that a robot has. */
export function ofRobot(name: string, what: string): string {
  return `api/robots/${encodeURIComponent(name)}/${what}`;
}
