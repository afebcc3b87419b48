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
export async function rest<T>(method: string, path: string, body?: object, timeout_ms = TIMEOUT_MS): Promise<T> {
  const response = await request(method, path, {
    body: body && JSON.stringify(body),
    keepalive: method !== "GET", // a stop arrives, too, when the page is closed behind it
    priority: method === "GET" ? "low" : "high",
    signal: AbortSignal.timeout(timeout_ms),
  });
  if (!response.ok) throw await refusalOf(response);
  return (await response.json()) as T;
}

/** A request with the token of this session. */
export function request(method: string, path: string, options: RequestInit): Promise<Response> {
  const secret = token();
  const headers: HeadersInit = secret ? { Authorization: `Bearer ${secret}` } : {};
  return fetch(path, { method, headers, cache: "no-store", ...options });
}

/** Why a response is a refusal, in the daemon's words if it has any. */
export async function refusalOf(response: Response): Promise<Refused> {
  const answer = (await response.json().catch(() => null)) as { error?: { reason?: string } } | null;
  const reason = answer?.error?.reason ?? `hostlink answers: ${response.statusText.toLowerCase()}`;
  return new Refused(response.status, forPeople(reason));
}

/** Without the request that a program would have to know. */
export function forPeople(reason: string): string {
  return reason.replace(/^[A-Z]+ \/\S*: /, "");
}

/** What to write beside a request that failed. */
export function reasonOf(error: unknown): string {
  if (error instanceof Refused) return error.message;
  return "hostlink does not answer. Try again.";
}

/** The path of something that a robot has. */
export function ofRobot(name: string, what: string): string {
  return `api/robots/${encodeURIComponent(name)}/${what}`;
}
