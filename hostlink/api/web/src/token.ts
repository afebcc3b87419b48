/** The token of this session: it comes in the page's address once, and leaves it at once. */

const KEY = "hostlink.token";

let known = kept();

/** Move a token from the address bar into the session's store; call it before any request. */
export function moveTokenFromAddress(): void {
  const address = new URL(location.href);
  const token = address.searchParams.get("token");
  if (token === null) return;
  keepToken(token);
  address.searchParams.delete("token");
  history.replaceState(null, "", address);
}

export function keepToken(token: string): void {
  known = token || null;
  try {
    if (token) sessionStorage.setItem(KEY, token);
    else sessionStorage.removeItem(KEY);
  } catch {
    return; // a browser may forbid to keep anything: then it holds until the page is left
  }
}

/** Null: none was given. */
export function token(): string | null {
  return known;
}

function kept(): string | null {
  try {
    return sessionStorage.getItem(KEY);
  } catch {
    return null;
  }
}
