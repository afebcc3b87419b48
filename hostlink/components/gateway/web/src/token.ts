/** The token of this session. The page's address has it once, and it is removed from there at once. */

const KEY = "hostlink.token";

let known = kept();

/** Move a token from the address bar into the session's storage; call this before any request. */
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
    return; // a browser may forbid storage: then the token holds until the page is closed
  }
}

/** Null without a token. */
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
