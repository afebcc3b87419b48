/** The REST API of docs/api.md. It works without the WebSocket. */

import { token } from "./token";

const TIMEOUT_MS = 1500;

/** An error answer of the daemon. */
export class Refused extends Error {
  constructor(
    readonly status: number,
    reason: string,
  ) {
    super(reason);
  }
}

/** Return the JSON of the answer. Throws Refused for an error answer, another error without an answer. */
export async function rest<T>(method: string, path: string, body?: object, timeout_ms = TIMEOUT_MS): Promise<T> {
  const response = await request(method, path, {
    body: body && JSON.stringify(body),
    keepalive: method !== "GET", // a stop is sent although the page is closed
    priority: method === "GET" ? "low" : "high",
    signal: AbortSignal.timeout(timeout_ms),
  });
  if (!response.ok) throw await refusalOf(response);
  return (await response.json()) as T;
}

/** Send a request with the token of this session. */
export function request(
  method: string,
  path: string,
  options: RequestInit,
  more: Record<string, string> = {},
): Promise<Response> {
  const secret = token();
  const headers: HeadersInit = secret ? { ...more, Authorization: `Bearer ${secret}` } : more;
  return fetch(path, { method, headers, cache: "no-store", ...options });
}

/** The reason of an error answer, in the daemon's words if it has any. */
export async function refusalOf(response: Response): Promise<Refused> {
  const answer = (await response.json().catch(() => null)) as { error?: { reason?: string } } | null;
  const reason = answer?.error?.reason ?? `hostlink answers: ${response.statusText.toLowerCase()}`;
  return new Refused(response.status, forPeople(reason));
}

/** Remove the method and path, which only programs need. */
export function forPeople(reason: string): string {
  return reason.replace(/^[A-Z]+ \/\S*: /, "");
}

/** The text to show for a failed request. */
export function reasonOf(error: unknown): string {
  if (error instanceof Refused) return error.message;
  return "hostlink does not answer. Try again.";
}

/** The path of a robot's resource. */
export function ofRobot(name: string, what: string): string {
  return `api/robots/${encodeURIComponent(name)}/${what}`;
}
