// Hands a text to the browser as a file to keep.

/** @param {string} name @param {string} text @param {string} [type] */
export function download(name, text, type = 'application/toml') {
  const link = document.createElement('a');
  const url = URL.createObjectURL(new Blob([text], { type }));
  Object.assign(link, { href: url, download: name });
  document.body.append(link);
  link.click();
  link.remove();
  setTimeout(() => URL.revokeObjectURL(url), 10_000);
}
