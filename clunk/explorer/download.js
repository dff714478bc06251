// Save what the server has made of a request, under the name that it gives.
const bytes = Uint8Array.from(atob(cb_obj.data.content[0]), (character) => character.charCodeAt(0));
const link = document.createElement("a");
link.href = URL.createObjectURL(new Blob([bytes], {type: cb_obj.data.type[0]}));
link.download = cb_obj.data.name[0];
link.click();
setTimeout(() => URL.revokeObjectURL(link.href), 10000);
