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
  const response = await request(method, path, {
    body: body && JSON.stringify(body),
    signal: AbortSignal.timeout(TIMEOUT_MS),
  });
  if (!response.ok) throw await refusalOf(response, `${method} ${path}`);
  return (await response.json()) as T;
}

/** A request with the token of this session. */
export function request(method: string, path: string, options: RequestInit): Promise<Response> {
  const secret = token();
  const headers: HeadersInit = secret ? { Authorization: `Bearer ${secret}` } : {};
  return fetch(path, { method, headers, cache: "no-store", ...options });
}

/** Why a response is a refusal, in the daemon's words if it has any. */
export async function refusalOf(response: Response, what: string): Promise<Refused> {
  const answer = (await response.json().catch(() => null)) as { error?: { reason?: string } } | null;
  return new Refused(response.status, answer?.error?.reason ?? `${what}: ${response.statusText}`);
}

/** The path of something that a robot has. */
export function ofRobot(name: string, what: string): string {
  return `api/robots/${encodeURIComponent(name)}/${what}`;
}
