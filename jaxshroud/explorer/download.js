// Let the browser save the file that the source holds, and forget it.
const { name, type, content } = cb_obj.data;
if (name.length > 0) {
  const bytes = Uint8Array.from(atob(content[0]), (c) => c.charCodeAt(0));
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([bytes], { type: type[0] }));
  link.download = name[0];
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}
